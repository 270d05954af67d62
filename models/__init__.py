"""Robot and arena: MJCF files, edits of them, and the kinematic simulator."""

from . import working_directory as working_directory  # first, before MuJoCo is imported

# isort: split
from .arena import (
    ARENA_XML,
    ROBOT_XML,
    Dimensions,
    arena_spec,
    check_arena,
    check_versions,
    half_size,
    robot_pose,
    robot_qpos,
)
from .arena_variants import (
    add_noses,
    add_obstacles,
    add_velocity,
    centre_nose,
    hide_spot,
    scale_torque,
)
from .kinematic import Kinematics

__all__ = [
    "ARENA_XML",
    "ROBOT_XML",
    "Dimensions",
    "Kinematics",
    "add_noses",
    "add_obstacles",
    "add_velocity",
    "arena_spec",
    "check_arena",
    "centre_nose",
    "check_versions",
    "half_size",
    "hide_spot",
    "robot_pose",
    "robot_qpos",
    "scale_torque",
]
