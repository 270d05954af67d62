"""Executors that a command's options choose."""

from __future__ import annotations

from typing import TYPE_CHECKING

from ..errors import InputError
from ..machine import cores

if TYPE_CHECKING:
    from ..lives.jobs import Executor


def executor(processes: int | None = None, ray: str | None = None, device: str = "cpu") -> Executor:
    """Returns the executor of a command's jobs; with Ray, it is connected to the cluster.

    Args:
      processes: Number of jobs that this machine runs at a time; None for its number of cores.
      ray: Address of a Ray cluster as HOST:PORT; None for this machine.
      device: Device of the experiment. On a GPU one job runs at a time, because jobs would share
        its memory.

    Raises:
      InputError: a value is invalid, there is no such cluster, or Ray is not installed or cannot be
        used with the device.
    """
    if processes is not None and (type(processes) is not int or processes < 1):
        raise InputError(f"processes must be a whole number of at least 1, got {processes!r:.60}")
    if ray is None:
        from ..lives.local import Local

        return Local(processes or cores() if device == "cpu" else 1)
    if device != "cpu":
        raise InputError(f"the device {device} is this machine's: Ray cannot be used with it")
    if processes is not None:
        raise InputError("--processes and --ray exclude each other: Ray uses its cluster's cores")
    from ..lives.ray_cluster import RayCluster

    return RayCluster(ray)
