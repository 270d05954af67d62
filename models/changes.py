"""Changes of the body: parameters of the robot's model, for robots that learned in another body."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping
from types import MappingProxyType

import mujoco
import numpy as np


@dataclasses.dataclass(frozen=True)
class BodyChange:
    """A change of the robot's body, an edit of the arena's model.

    Both simulators read it from the edited model: `task_definition(name).spec(edits=[change])`,
    `make_batch(name, robots, edits=[change])`, `make_kinematic_batch`.

    Attributes:
      says: Description in words.
      gains: Factor of the left and of the right motor's gain: a wheel turns at this factor of the
        speed at the same motor value. Negative for swapped polarity. The lag stays as it is.
      nose_turn: Angle in [rad] by which the nose is turned to the left; its place stays.
    """

    says: str
    gains: tuple[float, float] = (1.0, 1.0)
    nose_turn: float = 0.0

    def __post_init__(self) -> None:
        """Raises ValueError, with the field's name, for a value that is not finite."""
        if len(self.gains) != 2 or not all(map(math.isfinite, self.gains)):
            raise ValueError(f"gains must be two finite numbers, got {self.gains}")
        if not math.isfinite(self.nose_turn):
            raise ValueError(f"nose_turn must be finite, got {self.nose_turn}")

    def __call__(self, spec: mujoco.MjSpec) -> None:
        """Changes the body in an arena."""
        for name, gain in zip(("left_motor", "right_motor"), self.gains, strict=True):
            # Torque = gear * (gain * motor value - damping * gear * wheel speed): with the damping
            # unchanged, the wheel follows as fast as before, towards another speed.
            spec.actuator(name).gainprm[0] *= gain
        if self.nose_turn:
            turn = np.array([math.cos(self.nose_turn / 2), 0, 0, math.sin(self.nose_turn / 2)])
            nose, turned = spec.site("nose"), np.empty(4)
            mujoco.mju_mulQuat(turned, np.array(nose.quat), turn)
            nose.quat = turned


CHANGES: Mapping[str, BodyChange] = MappingProxyType(
    {
        "polarity": BodyChange("both wheels turn the other way round", gains=(-1.0, -1.0)),
        "half-gain": BodyChange("the left wheel turns at half the speed", gains=(0.5, 1.0)),
        "turned-nose": BodyChange(
            "the nose points 30 degrees to the left", nose_turn=math.radians(30)
        ),
        "left-reversed": BodyChange("the left wheel turns the other way round", gains=(-1.0, 1.0)),
        "sideways-nose": BodyChange(
            "the nose points 90 degrees to the left", nose_turn=math.radians(90)
        ),
    }
)
