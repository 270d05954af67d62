"""Who lives cohorts, as the commands are told: this machine's cores, or a cluster's."""

from __future__ import annotations

import dataclasses
import os
from typing import TYPE_CHECKING

from .errors import InputError

if TYPE_CHECKING:
    from .engine import Workforce


@dataclasses.dataclass(frozen=True)
class Workers:
    """The options of every command that lives cohorts."""

    processes: int = len(os.sched_getaffinity(0))
    """cohorts that live at a time, one core each"""
    engine: str = "local"
    """local, or ray: on an existing cluster, OUT on storage that all its nodes share"""
    address: str = "auto"
    """of the Ray cluster"""

    def workforce(self) -> Workforce:
        """These workers, connected.

        Raises:
          InputError: a number or a name makes no sense, or there is no such cluster.
        """
        if self.processes < 1:
            raise InputError(f"the number of processes must be at least 1, got {self.processes}")
        if self.engine == "ray":
            from . import cluster

            return cluster.Ray(self.address)
        if self.engine != "local":
            raise InputError(f"the engine must be local or ray, got {self.engine!r}")
        from .processes import Processes

        return Processes(self.processes)


HERE = Workers()  # as many as this machine has cores
