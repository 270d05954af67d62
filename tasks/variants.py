"""The rules of further tasks: the paper's signals, and rewards in [0, 1]."""

from __future__ import annotations

import dataclasses
from typing import ClassVar, Self

import mujoco as mj
import numpy as np

from ..models import Dimensions
from .arena import SensorLayout, SpotFindingRules, WallAvoidanceRules
from .sensors import Nose, NoseForm, contact_signal, distance_signal


class UnitWallAvoidanceRules(WallAvoidanceRules):
    """Wall avoidance with a reward of 1, and 0 in contact."""

    rewards: ClassVar = (0.0, 1.0)

    def reward(self, sensordata: np.ndarray) -> np.ndarray:
        """1 plus the contact signal, 1 or 0."""
        return 1.0 + super().reward(sensordata)


@dataclasses.dataclass(frozen=True)
class DrivingRules(WallAvoidanceRules):
    """Wall avoidance that rewards driving ahead, so that standing still does not pay.

    Attributes:
      velocity: where the velocity's numbers stand in `sensordata`.
      top_speed: of a wheel, in metres a second.
    """

    velocity: slice
    top_speed: float

    shapes: ClassVar = {**WallAvoidanceRules.shapes, "speed": (1, -1.0, 1.0)}
    rewards: ClassVar = (0.0, 1.0)

    @classmethod
    def of(cls, model: mj.MjModel, nose: NoseForm = "inverse") -> Self:
        """The rules for a compiled arena whose robot senses its velocity."""
        del nose
        top_speed = Dimensions.of(model).motor_speed
        return cls(SensorLayout.of(model), _place(model, "velocity"), top_speed)

    def observations(self, sensordata: np.ndarray) -> dict[str, np.ndarray]:
        """As in wall avoidance, and `speed` (..., 1): ahead, 1 at the top speed, -1 astern."""
        return {
            **super().observations(sensordata),
            "speed": self._speed(sensordata)[..., None],
        }

    def reward(self, sensordata: np.ndarray) -> np.ndarray:
        """The speed ahead; 0 astern and in contact."""
        free = 1.0 + super().reward(sensordata)
        return free * np.maximum(self._speed(sensordata), 0.0)

    def _speed(self, sensordata: np.ndarray) -> np.ndarray:
        ahead = sensordata[..., self.velocity][..., 0]
        return np.clip(ahead / self.top_speed, -1.0, 1.0)


@dataclasses.dataclass(frozen=True, kw_only=True)
class TwoNosesRules(SpotFindingRules):
    """Spot finding with a nose on either side, whose difference tells where to turn.

    What counts as in the spot is the front of the rim, as with one nose.

    Attributes:
      left: where the numbers of the left nose stand in `sensordata`.
      right: likewise.
    """

    left: slice
    right: slice

    shapes: ClassVar = {"noses": (2, 0.0, 1.0)}
    full: ClassVar = {"noses": Nose.odour, "reward": Nose.odour}

    @classmethod
    def of(cls, model: mj.MjModel, nose: NoseForm = "inverse") -> Self:
        """The rules for a compiled arena whose robot has two noses."""
        one = SpotFindingRules.of(model, nose)
        left, right = _place(model, "left_smell"), _place(model, "right_smell")
        return cls(one.layout, one.nose, left=left, right=right)

    def observations(self, sensordata: np.ndarray) -> dict[str, np.ndarray]:
        """`noses` (..., 2): Eq. 3 of the left and of the right one."""
        signals = [self.nose.signal(sensordata[..., side]) for side in (self.left, self.right)]
        return {"noses": np.stack(signals, axis=-1)}

    def reward(self, sensordata: np.ndarray) -> np.ndarray:
        """The mean of the two signals, in [0, 1)."""
        left, right = np.moveaxis(self.observations(sensordata)["noses"], -1, 0)
        return (left + right) / 2


class SpotAmongWallsRules(SpotFindingRules):
    """Spot finding by a robot that feels walls, too: what it smells in contact earns nothing."""

    shapes: ClassVar = {**SpotFindingRules.shapes, **WallAvoidanceRules.shapes}

    def observations(self, sensordata: np.ndarray) -> dict[str, np.ndarray]:
        """`nose` (..., 1), `distances` (..., 4) and `contact` (..., 1)."""
        return {
            "nose": self.nose.signal(sensordata[..., self.layout.smell])[..., None],
            "distances": distance_signal(sensordata[..., self.layout.distances]),
            "contact": contact_signal(sensordata[..., self.layout.touch]),
        }

    def reward(self, sensordata: np.ndarray) -> np.ndarray:
        """The nose signal, in [0, 1); 0 in contact."""
        free = 1.0 + contact_signal(sensordata[..., self.layout.touch])[..., 0]
        return free * super().reward(sensordata)


def _place(model: mj.MjModel, sensor: str) -> slice:
    """Where the three numbers of a sensor stand."""
    start = int(model.sensor(sensor).adr[0])
    return slice(start, start + 3)
