"""Wall avoidance (section 3.1) and its variants: rules and definitions."""

from __future__ import annotations

import dataclasses
import math
from typing import ClassVar, Self

import mujoco
import numpy as np

from ..models import Dimensions, add_obstacles, add_velocity, hide_spot
from ..models.arrays import at_least, at_most
from .arena import TaskDefinition
from .rules import Rules, SensorLayout, sensor_slice
from .sensors import NoseForm, contact_signal, distance_signal


class WallAvoidanceRules(Rules):
    """Rules of section 3.1: four distances and a contact signal, which is the reward."""

    shapes: ClassVar = {"distances": (4, 0.0, 1.0), "contact": (1, -1.0, 0.0)}
    rewards: ClassVar = (-1.0, 0.0)

    def observations(self, sensordata: np.ndarray) -> dict[str, np.ndarray]:
        """Returns `distances` (..., 4): front, back, left, right (Eq. 2); `contact` (..., 1)."""
        return {
            "distances": distance_signal(sensordata[..., self.layout.distances]),
            "contact": contact_signal(sensordata[..., self.layout.touch]),
        }

    def reward(self, sensordata: np.ndarray) -> np.ndarray:
        """Returns the contact signal: -1 in contact, else 0."""
        return contact_signal(sensordata[..., self.layout.touch])[..., 0]

    def event(self, sensordata: np.ndarray) -> np.ndarray:
        """Returns whether the robot is in contact."""
        return sensordata[..., self.layout.touch][..., 0] > 0


class UnitWallAvoidanceRules(WallAvoidanceRules):
    """Wall avoidance with a reward of 0 in contact, else 1."""

    rewards: ClassVar = (0.0, 1.0)

    def reward(self, sensordata: np.ndarray) -> np.ndarray:
        """Returns 1 plus the contact signal."""
        return 1.0 + super().reward(sensordata)


@dataclasses.dataclass(frozen=True)
class DrivingRules(WallAvoidanceRules):
    """Wall avoidance that rewards driving ahead, so that a robot at rest earns nothing.

    Attributes:
      velocity: Slice of `sensordata`: the velocity's components ahead, left and up, in [m/s].
      top_speed: Speed of a wheel at motor value 0.5 in [m/s], at which `speed` is 1.
    """

    velocity: slice
    top_speed: float

    shapes: ClassVar = {**WallAvoidanceRules.shapes, "speed": (1, -1.0, 1.0)}
    rewards: ClassVar = (0.0, 1.0)

    @classmethod
    def of(cls, model: mujoco.MjModel, nose: NoseForm = "inverse") -> Self:
        """Returns the rules for a compiled arena whose robot senses its velocity."""
        del nose
        velocity = sensor_slice(model, "velocity", 3)
        return cls(SensorLayout.of(model), velocity, Dimensions.of(model).motor_speed)

    def observations(self, sensordata: np.ndarray) -> dict[str, np.ndarray]:
        """Returns wall avoidance's signals, and `speed` (..., 1): 1 at top speed ahead."""
        return {
            **super().observations(sensordata),
            "speed": self._speed(sensordata)[..., None],
        }

    def reward(self, sensordata: np.ndarray) -> np.ndarray:
        """Returns the speed ahead, as a share of the top speed; 0 in reverse and in contact."""
        free = 1.0 + super().reward(sensordata)
        return free * at_least(self._speed(sensordata), 0.0)

    def _speed(self, sensordata: np.ndarray) -> np.ndarray:
        ahead = sensordata[..., self.velocity][..., 0]
        return at_most(at_least(ahead / self.top_speed, -1.0), 1.0)


PAPER = TaskDefinition(
    "wall_avoidance", WallAvoidanceRules, (hide_spot,), limit=0.5, time_limit=math.inf
)
UNIT = TaskDefinition("wall_avoidance_unit", UnitWallAvoidanceRules, (hide_spot,))
OBSTACLES = TaskDefinition(
    "wall_avoidance_obstacles", DrivingRules, (hide_spot, add_obstacles, add_velocity)
)
