"""The robot's tasks: sensors, rewards and starts, as dm_control environments and as batches."""

from .. import models as models  # first: it refuses a deleted working directory
from .batch import Batch, Robots, stop_timers
from .episode import CONTROL_TIMESTEP
from .kinematic import KinematicBatch, make_kinematic_batch
from .suite import (
    ALL_TASKS,
    BENCHMARKING,
    PAPER,
    SUITE,
    TASKS_BY_DOMAIN,
    load,
    make_batch,
    register,
)

__all__ = [
    "ALL_TASKS",
    "BENCHMARKING",
    "CONTROL_TIMESTEP",
    "PAPER",
    "SUITE",
    "TASKS_BY_DOMAIN",
    "Batch",
    "KinematicBatch",
    "Robots",
    "load",
    "make_batch",
    "make_kinematic_batch",
    "register",
    "stop_timers",
]
