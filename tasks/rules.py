"""What a robot senses and is rewarded for: the base class of every task's rules."""

from __future__ import annotations

import abc
import dataclasses
from collections.abc import Mapping
from typing import TYPE_CHECKING, ClassVar, Self

import mujoco
import numpy as np

from ..models.arrays import namespace

if TYPE_CHECKING:
    from .sensors import NoseForm

RANGEFINDERS = ("front", "back", "left", "right")
_ROUNDING = 1e-6  # by which a task's values may exceed their declared range


def sensor_slice(model: mujoco.MjModel, name: str, length: int) -> slice:
    """Returns the slice of `sensordata` with the first `length` numbers of a sensor.

    Raises KeyError where the arena lacks the sensor.
    """
    start = int(model.sensor(name).adr[0])
    return slice(start, start + length)


@dataclasses.dataclass(frozen=True)
class SensorLayout:
    """Indices of each sensor's numbers in MuJoCo's `sensordata`.

    Attributes:
      distances: Indices of the four rangefinders' distances in [m], in the order of `RANGEFINDERS`;
        a distance is -1 for no hit.
      touch: Indices at which the force on the rim, in newtons, is found.
      smell: Indices of the spot's centre in the frame of the nose: its distances ahead, to the
        left and up, in [m].
    """

    distances: slice
    touch: slice
    smell: slice

    @classmethod
    def of(cls, model: mujoco.MjModel) -> SensorLayout:
        """Reads the layout of a compiled arena.

        Raises KeyError where a sensor is missing, ValueError where the rangefinders do not follow
        each other in the order of `RANGEFINDERS`.
        """
        starts = [sensor_slice(model, name, 1).start for name in RANGEFINDERS]
        if starts != [*range(starts[0], starts[0] + len(starts))]:
            raise ValueError(
                f"the sensors {', '.join(RANGEFINDERS)} must follow each other in this order"
            )
        return cls(
            sensor_slice(model, RANGEFINDERS[0], len(RANGEFINDERS)),
            sensor_slice(model, "touch", 1),
            sensor_slice(model, "smell", 3),
        )


@dataclasses.dataclass(frozen=True)
class Rules(abc.ABC):
    """Observations, reward and measured event of a task, as functions of MuJoCo's sensors.

    Every method takes `sensordata` of shape (..., nsensordata), for one robot or a batch, and
    works on the last axis. The suite's tasks also take tensors of PyTorch, and return tensors.

    Attributes:
      layout: Indices of each sensor's numbers in `sensordata`.
      shapes: Length, minimum and maximum of each observation, by name.
      rewards: Minimum and maximum of the reward.
      maximal: Raw value s' at maximal smell of each signal s = s' / (1 + s') (Eq. 3), by name of
        the observation, or "reward". Signals of another form are left out.
      has_nose: Whether the robot smells the spot.
    """

    layout: SensorLayout

    shapes: ClassVar[Mapping[str, tuple[int, float, float]]]
    rewards: ClassVar[tuple[float, float]]
    maximal: ClassVar[Mapping[str, float]] = {}
    has_nose: ClassVar[bool] = False

    @classmethod
    def of(cls, model: mujoco.MjModel, nose: NoseForm = "inverse") -> Self:
        """Returns the rules for an arena and a form of Eq. 3; KeyError if a sensor is missing."""
        del nose
        return cls(SensorLayout.of(model))

    def bounds(self) -> tuple[np.ndarray, np.ndarray]:
        """Returns minimum and maximum of each number of `state`, each of shape (S,)."""
        lengths, low, high = zip(*self.shapes.values(), strict=True)
        return np.repeat(low, lengths), np.repeat(high, lengths)

    @abc.abstractmethod
    def observations(self, sensordata: np.ndarray) -> dict[str, np.ndarray]:
        """Returns the sensor signals by name, each of shape (..., n), in the order of `shapes`."""

    @abc.abstractmethod
    def reward(self, sensordata: np.ndarray) -> np.ndarray:
        """Returns each robot's reward, shape (...)."""

    @abc.abstractmethod
    def event(self, sensordata: np.ndarray) -> np.ndarray:
        """Returns whether the event holds that Learn Ability counts, shape (...)."""

    def checked_reward(self, sensordata: np.ndarray) -> np.ndarray:
        """Returns `reward(sensordata)`, shape (...), after a check.

        Raises ValueError unless rewards are real numbers of this shape, within `rewards`.
        """
        found = np.asarray(self.reward(sensordata))
        if not within(found, sensordata.shape[:-1], self.rewards):
            low, high = self.rewards
            raise ValueError(
                f"the reward of {type(self).__name__} must be numbers from {low:g} to {high:g} of "
                f"shape {sensordata.shape[:-1]}, got {found!r:.100}"
            )
        return found

    def state(self, sensordata: np.ndarray) -> np.ndarray:
        """Returns the state that a brain senses: all observations concatenated, shape (..., S)."""
        signals = list(self.observations(sensordata).values())
        return namespace(sensordata).concat(signals, axis=-1)


def within(values: np.ndarray, shape: tuple[int, ...], ends: tuple[float, float]) -> bool:
    """Returns whether values are real numbers of a shape, from `ends[0]` to `ends[1]`."""
    if values.shape != shape or values.dtype.kind not in "fiub":
        return False
    low, high = ends[0] - _ROUNDING, ends[1] + _ROUNDING
    if values.size == 1:  # a seventh of the time of the line below, in every step
        return low <= values.item() <= high
    return bool(((values >= low) & (values <= high)).all())
