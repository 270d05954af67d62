"""The robot's tasks: sensors, rewards and starts, as dm_control environments and as batches."""

from ..models.physics import Physics
from .arena import CONTROL_TIMESTEP, Task
from .batch import Batch, Robots, silence_warnings, stop_timers
from .kinematic.robots import KinematicBatch, make_kinematic_batch
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
    "Physics",
    "Robots",
    "Task",
    "load",
    "make_batch",
    "make_kinematic_batch",
    "register",
    "silence_warnings",
    "stop_timers",
]
