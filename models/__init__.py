"""The bodies: one MJCF of the robot, one of its arena, and how they are read."""

from .arena import (
    ARENA_XML,
    ROBOT_XML,
    Dimensions,
    arena_spec,
    check_versions,
    half_size,
    robot_pose,
    robot_qpos,
)

__all__ = [
    "ARENA_XML",
    "ROBOT_XML",
    "Dimensions",
    "arena_spec",
    "check_versions",
    "half_size",
    "robot_pose",
    "robot_qpos",
]
