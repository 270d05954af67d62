"""What several commands' options have in common, and who lives cohorts."""

from __future__ import annotations

import dataclasses
import os
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import tyro

from .errors import InputError

if TYPE_CHECKING:
    from .simulation.engine import Workforce


def cores() -> int:
    """Those that this process may use."""
    return len(os.sched_getaffinity(0)) if sys.platform == "linux" else os.cpu_count() or 1


def option(values: str, default: str) -> Any:
    """How help shows an option: what it takes, and what is done without it."""
    return tyro.conf.arg(metavar=values, help_behavior_hint=f"(default: {default})")


TASKS_TOLD = "{wall_avoidance,spot_finding}"  # what these name a test holds them to
PROPOSERS_TOLD = "{fixed,random,creative}"
BODIES_TOLD = "{mujoco,kinematic}"
COHORT_SIZE = "INT", "the largest divisor of ROBOTS up to 250"
KINEMATICS = "NAME=VALUE ..", "an ideal drive"

Out = Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="OUT")]
Runs = Annotated[
    tuple[Path, ...],
    tyro.conf.Positional,
    tyro.conf.arg(metavar="RUN [RUN ..]", help_behavior_hint="(required)"),
]
KinematicsTold = Annotated[tuple[str, ...], option(*KINEMATICS)]


@dataclasses.dataclass(frozen=True)
class Workers:
    """Who lives the cohorts that an engine spreads."""

    processes: int = cores()
    """cohorts that this machine lives at a time, one core each"""
    engine: Annotated[str, option("{local,ray}", "local")] = "local"
    """ray: on an existing cluster, OUT on storage that all its nodes share"""
    address: str = "auto"
    """of the Ray cluster"""

    def workforce(self) -> Workforce:
        """These workers, connected.

        Raises:
          InputError: a number or a name makes no sense, there is no such cluster, or no Ray here.
        """
        if self.processes < 1:
            raise InputError(f"the number of processes must be at least 1, got {self.processes}")
        if self.engine == "ray":
            from .simulation import ray_cluster as cluster

            return cluster.Ray(self.address)
        if self.engine != "local":
            raise InputError(f"the engine must be local or ray, got {self.engine!r}")
        from .simulation.local import Processes

        return Processes(self.processes)


HERE = Workers()  # as many as this machine has cores
WorkersTold = Annotated[Workers, tyro.conf.arg(name="")]
