"""Spot finding (section 3.2) and its variants: rules and definitions."""

from __future__ import annotations

import dataclasses
import math
from typing import ClassVar, Self

import mujoco
import numpy as np

from ..models import Dimensions, add_noses, add_velocity
from ..models.arrays import namespace
from .arena import TaskDefinition
from .rules import Rules, SensorLayout, sensor_slice
from .sensors import Nose, NoseForm, contact_signal
from .wall_avoidance import DrivingRules, WallAvoidanceRules


@dataclasses.dataclass(frozen=True)
class SpotFindingRules(Rules):
    """Rules of section 3.2: one nose, whose signal is the reward.

    Attributes:
      nose: Parameters of Eq. 3; the radius is that of the arena's spot.
    """

    nose: Nose = Nose()

    shapes: ClassVar = {"nose": (1, 0.0, 1.0)}
    rewards: ClassVar = (0.0, 1.0)
    maximal: ClassVar = {"nose": Nose.odour, "reward": Nose.odour}
    has_nose: ClassVar = True

    @classmethod
    def of(cls, model: mujoco.MjModel, nose: NoseForm = "inverse") -> Self:
        """Returns the rules for a compiled arena, with the radius of its spot."""
        radius = Dimensions.of(model).spot_radius
        return cls(SensorLayout.of(model), Nose(spot_radius=radius, form=nose))

    def observations(self, sensordata: np.ndarray) -> dict[str, np.ndarray]:
        """Returns `nose` (..., 1): Eq. 3."""
        return {"nose": self.nose.signal(sensordata[..., self.layout.smell])[..., None]}

    def reward(self, sensordata: np.ndarray) -> np.ndarray:
        """Returns the nose signal, in [0, 1)."""
        return self.nose.signal(sensordata[..., self.layout.smell])

    def event(self, sensordata: np.ndarray) -> np.ndarray:
        """Returns whether the nose is inside the spot."""
        return self.nose.inside(sensordata[..., self.layout.smell])


@dataclasses.dataclass(frozen=True, kw_only=True)
class TwoNosesRules(SpotFindingRules):
    """Spot finding with two noses: the difference of their signals shows the spot's side.

    The event is the same as with one nose: the front of the rim is inside the spot.

    Attributes:
      left: Slice of `sensordata`: the spot's centre (x, y, z in [m]) in the left nose's frame.
      right: Slice of `sensordata`: the spot's centre (x, y, z in [m]) in the right nose's frame.
    """

    left: slice
    right: slice

    shapes: ClassVar = {"noses": (2, 0.0, 1.0)}
    maximal: ClassVar = {"noses": Nose.odour, "reward": Nose.odour}

    @classmethod
    def of(cls, model: mujoco.MjModel, nose: NoseForm = "inverse") -> Self:
        """Returns the rules for a compiled arena whose robot has two noses."""
        one = SpotFindingRules.of(model, nose)
        left, right = (sensor_slice(model, f"{side}_smell", 3) for side in ("left", "right"))
        return cls(one.layout, one.nose, left=left, right=right)

    def observations(self, sensordata: np.ndarray) -> dict[str, np.ndarray]:
        """Returns `noses` (..., 2): Eq. 3 of the left and of the right nose."""
        sides = [sensordata[..., side] for side in (self.left, self.right)]
        return {"noses": self.nose.signal(namespace(sensordata).stack(sides, axis=-2))}

    def reward(self, sensordata: np.ndarray) -> np.ndarray:
        """Returns the mean of the two signals, in [0, 1)."""
        noses = self.observations(sensordata)["noses"]
        return (noses[..., 0] + noses[..., 1]) / 2


class SpotAmongWallsRules(SpotFindingRules, WallAvoidanceRules):
    """Spot finding with wall sensing: the reward is 0 in contact."""

    shapes: ClassVar = {**SpotFindingRules.shapes, **WallAvoidanceRules.shapes}

    def observations(self, sensordata: np.ndarray) -> dict[str, np.ndarray]:
        """Returns `nose` (..., 1), `distances` (..., 4) and `contact` (..., 1)."""
        return super().observations(sensordata) | WallAvoidanceRules.observations(self, sensordata)

    def reward(self, sensordata: np.ndarray) -> np.ndarray:
        """Returns the nose signal, in [0, 1); 0 in contact."""
        free = 1.0 + contact_signal(sensordata[..., self.layout.touch])[..., 0]
        return free * super().reward(sensordata)


@dataclasses.dataclass(frozen=True, kw_only=True)
class SpotOrDrivingRules(SpotAmongWallsRules):
    """Spot finding with wall sensing, in a life that may reward driving instead.

    Attributes:
      driving: Rules that give the reward in a phase that rewards driving.
    """

    driving: DrivingRules

    # The reward is not always a saturating smell.
    maximal: ClassVar = {"nose": Nose.odour}

    @classmethod
    def of(cls, model: mujoco.MjModel, nose: NoseForm = "inverse") -> Self:
        """Returns the rules for a compiled arena whose robot senses its velocity."""
        one = SpotFindingRules.of(model, nose)
        return cls(one.layout, one.nose, driving=DrivingRules.of(model))


PAPER = TaskDefinition("spot_finding", SpotFindingRules, limit=0.5, time_limit=math.inf)
UNIT = TaskDefinition("spot_finding_unit", SpotFindingRules)
TWO_NOSES = TaskDefinition("spot_finding_two_noses", TwoNosesRules, (add_noses,))
WALLS = TaskDefinition("spot_finding_walls", SpotAmongWallsRules)
JUMPING = TaskDefinition("spot_finding_jumping", SpotFindingRules, spot_seconds=20.0)
# The task of the life `tasks`; in no list of the suite.
OR_DRIVING = TaskDefinition("spot_or_driving", SpotOrDrivingRules, (add_velocity,))
