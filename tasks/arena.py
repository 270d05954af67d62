"""The domain "arena": one physics, and the paper's two tasks in it (sections 3.1 and 3.2)."""

from __future__ import annotations

import abc
import collections
import dataclasses
import functools
from collections.abc import Mapping
from typing import Any, ClassVar

import mujoco as mj
import numpy as np
from dm_control import mujoco
from dm_control.mujoco.wrapper import MjModel
from dm_control.rl import control
from dm_control.suite import base
from dm_control.utils import containers
from dm_env import specs

from ..models import Dimensions, arena_spec, robot_pose, robot_qpos
from .senses import Nose, NoseForm, contact_signal, distance_signal

CONTROL_TIMESTEP = 0.1  # seconds; the cycle time of section 3
RANGEFINDERS = ("front", "back", "left", "right")

SUITE = containers.TaggedTasks()


@dataclasses.dataclass(frozen=True)
class SensorLayout:
    """Where each sensor's numbers stand in MuJoCo's `sensordata`."""

    distances: slice
    touch: slice
    smell: slice

    @classmethod
    def of(cls, model: mj.MjModel) -> SensorLayout:
        """Reads the layout of a compiled arena."""

        def place(first: str, length: int) -> slice:
            start = int(model.sensor(first).adr[0])
            return slice(start, start + length)

        return cls(place(RANGEFINDERS[0], 4), place("touch", 1), place("smell", 3))


class Physics(mujoco.Physics):
    """The arena with named queries.

    A sensor shows the last instant at which MuJoCo evaluated it: after `step`, the start of
    the last substep (docs/physics.md), as in the batch of robots.
    """

    @functools.cached_property
    def dimensions(self) -> Dimensions:
        """Of the robot, the arena and the spot."""
        return Dimensions.of(self.model.ptr)

    @functools.cached_property
    def layout(self) -> SensorLayout:
        """Of `data.sensordata`."""
        return SensorLayout.of(self.model.ptr)

    def robot_pose(self) -> np.ndarray:
        """Returns x, y in metres and heading in radians, shape (3,)."""
        return robot_pose(self.data.qpos)

    def spot_position(self) -> np.ndarray:
        """Returns x, y of the odorous spot's centre, in metres, shape (2,)."""
        return self.data.mocap_pos[0, :2].copy()

    def distances(self) -> np.ndarray:
        """Returns the four rangefinders' distances, in metres, -1 for a miss, shape (4,)."""
        return self.data.sensordata[self.layout.distances].copy()

    def touch_force(self) -> np.ndarray:
        """Returns the force that the rim feels, in newton, shape (1,)."""
        return self.data.sensordata[self.layout.touch].copy()

    def spot_from_nose(self) -> np.ndarray:
        """Returns the spot's centre in the frame of the nose, in metres, shape (3,)."""
        return self.data.sensordata[self.layout.smell].copy()

    def place_robot(self, x: float, y: float, heading: float) -> None:
        """Puts the robot, at rest, at x, y (metres), looking along heading (radians)."""
        self.data.qpos[:] = robot_qpos(np.array([x, y, heading]))
        self.data.qvel[:] = 0
        self.data.ctrl[:] = 0

    def place_spot(self, x: float, y: float) -> None:
        """Puts the spot's centre at x, y, in metres; sensors show it from the next step on."""
        self.data.mocap_pos[0, :2] = x, y


@dataclasses.dataclass(frozen=True)
class Rules(abc.ABC):
    """What a robot senses in a task and is rewarded for, as functions of MuJoCo's sensors.

    Every method takes `sensordata` of shape (..., nsensordata), for one robot or a batch,
    and works on the last axis.

    Attributes:
      layout: where each sensor's numbers stand.
      shapes: of each observation, how many numbers, their minimum and their maximum.
    """

    layout: SensorLayout

    shapes: ClassVar[Mapping[str, tuple[int, float, float]]]

    @abc.abstractmethod
    def observations(self, sensordata: np.ndarray) -> dict[str, np.ndarray]:
        """The named sensor signals, each of shape (..., n), in the order of `shapes`."""

    @abc.abstractmethod
    def reward(self, sensordata: np.ndarray) -> np.ndarray:
        """The reward, shape (...): a sensor signal itself (section 2)."""

    @abc.abstractmethod
    def event(self, sensordata: np.ndarray) -> np.ndarray:
        """Whether what Learn Ability measures the time of is happening, shape (...)."""

    def state(self, sensordata: np.ndarray) -> np.ndarray:
        """All observations side by side, the state of the paper, shape (..., S)."""
        return np.concatenate(list(self.observations(sensordata).values()), axis=-1)


class WallAvoidanceRules(Rules):
    """Section 3.1: feel the walls with four distances and a contact; contact is punished."""

    shapes: ClassVar = {"distances": (4, 0.0, 1.0), "contact": (1, -1.0, 0.0)}

    def observations(self, sensordata: np.ndarray) -> dict[str, np.ndarray]:
        """`distances` (..., 4): front, back, left, right (Eq. 2); and `contact` (..., 1)."""
        return {
            "distances": distance_signal(sensordata[..., self.layout.distances]),
            "contact": contact_signal(sensordata[..., self.layout.touch]),
        }

    def reward(self, sensordata: np.ndarray) -> np.ndarray:
        """The contact signal, -1 or 0."""
        return contact_signal(sensordata[..., self.layout.touch])[..., 0]

    def event(self, sensordata: np.ndarray) -> np.ndarray:
        """Whether the robot is in contact."""
        return sensordata[..., self.layout.touch][..., 0] > 0


@dataclasses.dataclass(frozen=True)
class SpotFindingRules(Rules):
    """Section 3.2: smell the spot with one nose; its signal is the reward."""

    nose: Nose = Nose()

    shapes: ClassVar = {"nose": (1, 0.0, 1.0)}

    def observations(self, sensordata: np.ndarray) -> dict[str, np.ndarray]:
        """`nose` (..., 1): Eq. 3."""
        return {"nose": self.reward(sensordata)[..., None]}

    def reward(self, sensordata: np.ndarray) -> np.ndarray:
        """The nose signal, in [0, 1)."""
        return self.nose.signal(sensordata[..., self.layout.smell])

    def event(self, sensordata: np.ndarray) -> np.ndarray:
        """Whether the nose is inside the spot."""
        return self.nose.inside(sensordata[..., self.layout.smell])


def random_poses(
    random: np.random.RandomState | np.random.Generator, dimensions: Dimensions, count: int
) -> np.ndarray:
    """Draws poses uniformly over the arena, clear of the walls by a centimetre.

    Args:
      random: the random stream to draw from.
      dimensions: of the arena and the robot.
      count: how many.

    Returns:
      x, y in metres and heading in radians, shape (count, 3).
    """
    clear = dimensions.radius + 0.01
    high = np.array([dimensions.half_length - clear, dimensions.half_width - clear, np.pi])
    return random.uniform(-high, high, (count, 3))


def random_spots(
    random: np.random.RandomState | np.random.Generator, dimensions: Dimensions, count: int
) -> np.ndarray:
    """Draws centres of the spot uniformly, the whole spot inside the arena.

    Args:
      random: the random stream to draw from.
      dimensions: of the arena and the spot.
      count: how many.

    Returns:
      x, y in metres, shape (count, 2).
    """
    r = dimensions.spot_radius
    high = np.array([dimensions.half_length - r, dimensions.half_width - r])
    return random.uniform(-high, high, (count, 2))


class Task(base.Task):
    """What both tasks share: starts, signals as observations, a motor in [-0.5, 0.5].

    Attributes:
      rules: what the robot senses and is rewarded for.
    """

    rules: Rules

    def __init__(
        self,
        rules: Rules,
        *,
        robot: tuple[float, float, float] | None = None,
        spot: tuple[float, float] | None = None,
        random: np.random.RandomState | int | None = None,
    ) -> None:
        """Makes a task.

        Args:
          rules: what the robot senses and is rewarded for.
          robot: where it starts: x, y in metres and heading in radians; None draws it anew
            for every episode.
          spot: where the spot lies: x, y in metres; None draws it anew for every episode.
          random: a RandomState, a seed for one, or None for a seed of the machine's.
        """
        super().__init__(random=random)
        self.rules = rules
        self._robot = robot
        self._spot = spot

    def initialize_episode(self, physics: Physics) -> None:
        """Places robot and spot."""
        robot, spot = self._robot, self._spot
        if robot is None:
            robot = random_poses(self.random, physics.dimensions, 1)[0]
        if spot is None:
            spot = random_spots(self.random, physics.dimensions, 1)[0]
        physics.place_robot(*robot)
        physics.place_spot(*spot)
        super().initialize_episode(physics)

    def before_step(self, action: np.ndarray, physics: Physics) -> None:
        """Sets the motors, left and right; values beyond [-0.5, 0.5] are clipped.

        Raises:
          ValueError: the action is not two finite numbers.
        """
        action = np.asarray(action, dtype=float)
        if action.shape != (2,) or not np.isfinite(action).all():
            raise ValueError(f"an action is two finite motor values, got {action!r}")
        physics.set_control(np.clip(action, -0.5, 0.5))

    def get_observation(self, physics: Physics) -> collections.OrderedDict[str, np.ndarray]:
        """Returns the sensor signals by name, each of shape (n,)."""
        observations = self.rules.observations(physics.data.sensordata[None])
        return collections.OrderedDict((name, value[0]) for name, value in observations.items())

    def observation_spec(self, physics: Physics) -> collections.OrderedDict[str, Any]:
        """Returns the bounds of every observation."""
        del physics
        return collections.OrderedDict(
            (name, _bounded(name, length, low, high))
            for name, (length, low, high) in self.rules.shapes.items()
        )

    def get_reward(self, physics: Physics) -> float:
        """Returns the reward: the contact or the nose signal."""
        return float(self.rules.reward(physics.data.sensordata[None])[0])

    def after_step(self, physics: Physics) -> None:
        """Colours the robot's shell by the reward, where `visualize_reward` asks for it."""
        if self._visualize_reward:
            reward = abs(self.get_reward(physics))
            highlight = np.array([0.95, 0.25, 0.15, 1.0])
            if not hasattr(self, "_shell"):
                self._shell = physics.named.model.mat_rgba["musebot/shell"].copy()
            physics.named.model.mat_rgba["musebot/shell"] = (
                reward * highlight + (1 - reward) * self._shell
            )


class WallAvoidance(Task):
    """Section 3.1: stay away from the walls.

    Observations `distances` (4, in [0, 1], Eq. 2: front, back, left, right) and `contact`
    (1, -1 or 0); reward -1 while in contact, else 0.
    """


class SpotFinding(Task):
    """Section 3.2: go to the odorous spot and stay there.

    Observation `nose` (1, in [0, 1), Eq. 3); reward the same signal.
    """


def make_physics(*, motor_speed: float | None = None) -> Physics:
    """Compiles the arena (see `models.arena_spec` for the argument)."""
    return Physics.from_model(MjModel(arena_spec(motor_speed=motor_speed).compile()))


def wall_avoidance_rules(model: mj.MjModel) -> WallAvoidanceRules:
    """The rules of section 3.1 for a compiled arena."""
    return WallAvoidanceRules(SensorLayout.of(model))


def spot_finding_rules(model: mj.MjModel, nose: NoseForm = "inverse") -> SpotFindingRules:
    """The rules of section 3.2 for a compiled arena."""
    radius = Dimensions.of(model).spot_radius
    return SpotFindingRules(SensorLayout.of(model), Nose(spot_radius=radius, form=nose))


@SUITE.add("paper")
def wall_avoidance(
    time_limit: float = float("inf"),
    random: np.random.RandomState | int | None = None,
    environment_kwargs: Mapping[str, Any] | None = None,
    **start: Any,
) -> control.Environment:
    """Returns the wall avoidance task; `robot=(x, y, heading)` fixes the start."""
    physics = make_physics()
    task = WallAvoidance(wall_avoidance_rules(physics.model.ptr), random=random, **start)
    return _environment(physics, task, time_limit, environment_kwargs)


@SUITE.add("paper")
def spot_finding(
    time_limit: float = float("inf"),
    random: np.random.RandomState | int | None = None,
    environment_kwargs: Mapping[str, Any] | None = None,
    nose: NoseForm = "inverse",
    **start: Any,
) -> control.Environment:
    """Returns the spot finding task; `robot=` and `spot=` fix the start, `nose=` Eq. 3."""
    physics = make_physics()
    task = SpotFinding(spot_finding_rules(physics.model.ptr, nose), random=random, **start)
    return _environment(physics, task, time_limit, environment_kwargs)


def _environment(
    physics: Physics,
    task: Task,
    time_limit: float,
    environment_kwargs: Mapping[str, Any] | None,
) -> control.Environment:
    # legacy_step=False: plain mj_step, as the batch's rollout does, so that both agree.
    settings = {"control_timestep": CONTROL_TIMESTEP, "legacy_step": False}
    settings.update(environment_kwargs or {})
    return control.Environment(physics, task, time_limit=time_limit, **settings)


def _bounded(name: str, length: int, low: float, high: float) -> Any:
    return specs.BoundedArray((length,), np.float64, low, high, name=name)
