"""Options that several commands share."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import tyro


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
# Effects of the MuJoCo body that the kinematic simulator can have (docs/physics.md).
BODY_EFFECTS = "felt=pushed", "wall=turns", "lag=0.08"
BodyKinematicsOption = Annotated[tuple[str, ...], option(KINEMATICS[0], " ".join(BODY_EFFECTS))]
