"""The options of a command that say what runs its jobs.

Light to import: the modules for processes and clusters are imported when they are needed.
"""

from __future__ import annotations

import dataclasses
from typing import TYPE_CHECKING, Annotated, Literal

import tyro

from ..cli.shared_options import option
from ..errors import InputError
from ..machine import cores

if TYPE_CHECKING:
    from .jobs import Executor


@dataclasses.dataclass(frozen=True)
class Workers:
    """The processes that run the jobs of a run or a study."""

    processes: Annotated[int | None, option("INT", "the number of cores")] = None
    """number of jobs that this machine runs at a time, one core each; on a GPU always one"""
    engine: Literal["local", "ray"] = "local"
    """local: this machine; ray: a cluster, with OUT on storage that all its nodes share"""
    address: Annotated[str | None, option("HOST:PORT", "auto")] = None
    """address of the Ray cluster"""

    def executor(self, device: str = "cpu") -> Executor:
        """Returns the executor; with Ray, it is connected to the cluster.

        Args:
          device: Device of the experiment. On a GPU one job runs at a time, because jobs would
            share its memory.

        Raises:
          InputError: a value is invalid, there is no such cluster, or Ray is not installed or
            cannot be used with the device.
        """
        if self.processes is not None and self.processes < 1:
            raise InputError(f"processes must be at least 1, got {self.processes}")
        if self.engine not in ("local", "ray"):
            raise InputError(f"engine must be local or ray, got {self.engine!r:.60}")
        if self.engine == "ray" and device != "cpu":
            raise InputError(f"the device {device} is this machine's: Ray cannot be used with it")
        if self.engine == "ray":
            if self.processes is not None:
                raise InputError(
                    "--processes is for the engine local: Ray uses its cluster's cores"
                )
            from . import ray_cluster

            return ray_cluster.RayCluster("auto" if self.address is None else self.address)
        if self.address is not None:
            raise InputError(f"--address is for the engine ray, got {self.address} with local")
        from .local import Local

        return Local(self.processes or cores() if device == "cpu" else 1)


HERE = Workers()  # as many processes as this machine has cores
WorkersOption = Annotated[Workers, tyro.conf.arg(name="")]
