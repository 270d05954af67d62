"""The conditions in a phase of a life: the wheels' wiring, the senses, what is rewarded."""

from __future__ import annotations

import dataclasses
import math
from typing import Any, Literal

import numpy as np

from ..fields import Checked, choice, number, numbers
from .rules import RANGEFINDERS, Rules

Rewarded = Literal["task", "driving"]
SENSORS = ("nose", *RANGEFINDERS, "contact")
_UNCHANGED = (1.0, 0.0, 0.0, 1.0)
_DRIVES = 0.5  # smallest speed ahead that counts as driving, as a share of the top speed


@dataclasses.dataclass(frozen=True)
class World(Checked):
    """The conditions in a phase of a life; the default changes nothing.

    Robots receive no signal that names the world. A world changes what reaches motors and brain,
    not the simulator; on a GPU, only the default is possible.

    Attributes:
      wheels: Matrix (a, b, c, d). For motor values l and r, the left wheel receives a l + b r, the
        right one c l + d r. (-1, 0, 0, 1) reverses the left wheel.
      nose: Angle of the nose on the rim in degrees, counterclockwise from the front.
      sensors: Sensors that read wrong: name, offset and gain of each. A sensor reads offset + gain
        * signal, clipped to its range; (name, 0, 0) is a dead one. Names are those of `SENSORS`.
      rewarded: "task": reward and measured event are the task's own. "driving": the reward is the
        speed ahead as a share of the top speed, 0 in reverse or in contact, as in the task
        `wall_avoidance_obstacles`; the event is a reward of at least 0.5.
    """

    wheels: tuple[float, ...] = numbers(_UNCHANGED, -1, 1, 4)
    nose: float = number(0.0, -360, 360, unit="degrees")
    sensors: tuple[tuple[str, float, float], ...] = ()
    rewarded: Rewarded = choice("task", Rewarded)

    def __post_init__(self) -> None:
        """Turns lists, as files have them, into tuples; ValueError if a value is not allowed."""
        for name in ("wheels", "sensors"):
            object.__setattr__(self, name, _tuples(getattr(self, name)))
        super().__post_init__()
        if len(self.wheels) != len(_UNCHANGED):
            raise ValueError(f"wheels must be 4 numbers, got {self.wheels}")
        sound = isinstance(self.sensors, tuple) and all(map(_is_sensor, self.sensors))
        if not sound or len({name for name, *_ in self.sensors}) < len(self.sensors):
            raise ValueError(
                f"sensors must be a list of [name, offset, gain], with different names of "
                f"{', '.join(SENSORS)} and numbers from -1 to 1, got {self.sensors!r:.100}"
            )

    def motors(self, motors: Any) -> Any:
        """Returns what the wheels receive for motor values, both of shape (..., 2).

        If the world changes motor values, both are clipped to [-0.5, 0.5].
        """
        if self.wheels == _UNCHANGED:
            return motors
        left, right = np.moveaxis(np.clip(motors, -0.5, 0.5), -1, 0)
        a, b, c, d = self.wheels  # no product of matrices: its rounding depends on the shape
        wired = np.stack([a * left + b * right, c * left + d * right], axis=-1)
        return np.clip(wired, -0.5, 0.5)

    def rules(self, rules: Rules, nose: float) -> Rules:
        """Returns a task's rules in this world.

        Args:
          rules: Rules of the task in the default world.
          nose: Distance of the nose from the robot's centre in [m].

        Raises ValueError where the task's robot does not sense what the world changes or rewards.
        """
        if self == World():
            return rules
        return WorldRules(rules.layout, rules, self, nose)


def _tuples(value: Any) -> Any:
    return tuple(map(_tuples, value)) if isinstance(value, list | tuple) else value


def _is_sensor(entry: Any) -> bool:
    if not isinstance(entry, tuple) or len(entry) != 3 or entry[0] not in SENSORS:
        return False
    real = (isinstance(value, int | float) and type(value) is not bool for value in entry[1:])
    return all(real) and all(-1 <= value <= 1 for value in entry[1:])


@dataclasses.dataclass(frozen=True)
class WorldRules(Rules):
    """Rules of a task in a world.

    Attributes:
      task: Rules of the task in the default world.
      world: World that changes the task's rules.
      nose: Distance of the nose from the robot's centre in [m].
    """

    task: Rules
    world: World
    nose: float

    def __post_init__(self) -> None:
        """Raises ValueError, see `World.rules`."""
        for name in ("shapes", "rewards", "maximal", "has_nose"):
            object.__setattr__(self, name, getattr(self.task, name))
        kinds = ((kind, length) for kind, (length, *_) in self.shapes.items())
        sensed = {name for kind in kinds for name in sensor_names(*kind)}
        for name, *_ in self.world.sensors:
            if name not in sensed:
                names = ", ".join(sorted(sensed & {*SENSORS})) or "none that can be wrong"
                raise ValueError(f"the sensors of this task are {names}, got {name!r}")
        if self.world.nose and "nose" not in self.shapes:
            raise ValueError("the robot of this task has no single nose, which a world could turn")
        if self.world.rewarded == "driving" and not hasattr(self.task, "driving"):
            raise ValueError("only the task spot_or_driving can reward driving")

    def observations(self, sensordata: np.ndarray) -> dict[str, np.ndarray]:
        """Returns the task's observations, as the world's sensors read them."""
        found = self.task.observations(self._turned(sensordata))
        wrong = {name: (offset, gain) for name, offset, gain in self.world.sensors}
        for kind, (length, low, high) in self.shapes.items() if wrong else ():
            pairs = [wrong.get(name, (0.0, 1.0)) for name in sensor_names(kind, length)]
            offset, gain = np.array(pairs).T
            found[kind] = np.clip(offset + gain * found[kind], low, high)
        return found

    def reward(self, sensordata: np.ndarray) -> np.ndarray:
        """Returns the reward in this world, shape (...)."""
        if self.world.rewarded == "driving":
            return self._driving(sensordata)
        return self.task.reward(self._turned(sensordata))

    def event(self, sensordata: np.ndarray) -> np.ndarray:
        """Returns whether the event holds, the task's own or that of driving, shape (...)."""
        if self.world.rewarded == "driving":
            return self._driving(sensordata) >= _DRIVES
        return self.task.event(self._turned(sensordata))

    def _driving(self, sensordata: np.ndarray) -> np.ndarray:
        task: Any = self.task
        return task.driving.reward(sensordata)

    def _turned(self, sensordata: np.ndarray) -> np.ndarray:
        """Returns the measurements with the spot in the frame of the turned nose."""
        if not self.world.nose:
            return sensordata
        turned, ahead = sensordata.copy(), self.layout.smell.start
        angle = math.radians(self.world.nose)
        x, y = sensordata[..., ahead] + self.nose, sensordata[..., ahead + 1]
        turned[..., ahead] = math.cos(angle) * x + math.sin(angle) * y - self.nose
        turned[..., ahead + 1] = math.cos(angle) * y - math.sin(angle) * x
        return turned


def sensor_names(kind: str, length: int) -> tuple[str, ...]:
    """Returns the name of the sensor behind each number of an observation."""
    ours = kind == "distances" and length == len(RANGEFINDERS)
    return RANGEFINDERS if ours else (kind,) * length
