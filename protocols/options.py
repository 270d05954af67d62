"""Options that several commands share, and what runs their jobs."""

from __future__ import annotations

import dataclasses
import os
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import tyro

from .errors import InputError

if TYPE_CHECKING:
    from .simulation.jobs import Executor


def cores() -> int:
    """Returns the number of cores that this process may use."""
    return len(os.sched_getaffinity(0)) if sys.platform == "linux" else os.cpu_count() or 1


def option(values: str, default: str) -> Any:
    """Returns how help shows an option: the values it takes, and its default."""
    return tyro.conf.arg(metavar=values, help_behavior_hint=f"(default: {default})")


# Names as help shows them, without the imports that define them; a test compares the two.
TASK_CHOICES = "{wall_avoidance,spot_finding}"
PROPOSER_CHOICES = "{fixed,random,creative}"
BODY_CHOICES = "{mujoco,kinematic}"
COHORT_SIZE = "INT", "the largest divisor of ROBOTS up to 250"
KINEMATICS = "NAME=VALUE ..", "an ideal differential drive"

Out = Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="OUT")]
Runs = Annotated[
    tuple[Path, ...], tyro.conf.arg(metavar="RUN [RUN ..]", help_behavior_hint="(required)")
]
KinematicsOption = Annotated[tuple[str, ...], option(*KINEMATICS)]


@dataclasses.dataclass(frozen=True)
class Workers:
    """What runs the jobs of a run or a study."""

    processes: int = cores()
    """number of jobs that this machine runs at a time, one core each"""
    engine: Literal["local", "ray"] = "local"
    """ray: on an existing cluster, with OUT on storage that all its nodes share"""
    address: str = "auto"
    """address of the Ray cluster, as host:port"""

    def executor(self) -> Executor:
        """Returns the executor, connected.

        Raises:
          InputError: a value is invalid, there is no such cluster, or Ray is not installed.
        """
        if self.processes < 1:
            raise InputError(f"processes must be at least 1, got {self.processes}")
        if self.engine == "ray":
            from .simulation import ray_cluster

            return ray_cluster.RayCluster(self.address)
        from .simulation.local import Local

        return Local(self.processes)


HERE = Workers()  # as many processes as this machine has cores
WorkersOption = Annotated[Workers, tyro.conf.arg(name="")]
