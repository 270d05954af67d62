"""The arena as dm_control knows it: its physics, and the paper's two tasks (3.1 and 3.2).

The table of all tasks, the paper's and further ones, is in `suite.py`.
"""

from __future__ import annotations

import abc
import collections
import dataclasses
import functools
import math
from collections.abc import Mapping
from typing import Any, ClassVar, Literal, Self

import mujoco as mj
import numpy as np
from dm_control import mujoco
from dm_control.rl import control
from dm_control.suite import base
from dm_env import specs

from ..models import Dimensions, arena_spec, half_size, robot_pose, robot_qpos
from .sensors import Nose, NoseForm, contact_signal, distance_signal

CONTROL_TIMESTEP = 0.1  # seconds; the cycle time of section 3
RANGEFINDERS = ("front", "back", "left", "right")

Corner = Literal["upper_left", "upper_right"]
# Section 3.1: "a distance of ten cm to the walls facing the corner": x, y in metres, heading.
FROM_WALLS = 0.10  # metres
_X, _Y = (half - FROM_WALLS for half in half_size(arena_spec()))
CORNERS: Mapping[str, tuple[float, float, float]] = {
    "upper_left": (-_X, _Y, math.atan2(1, -1)),
    "upper_right": (_X, _Y, math.atan2(1, 1)),
}

Random = np.random.RandomState | np.random.Generator


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
      rewards: the smallest and the largest.
      full: of the signals that saturate as s = s' / (1 + s') in Eq. 3, by name, "reward" too:
        the raw s' at a full load.
    """

    layout: SensorLayout

    shapes: ClassVar[Mapping[str, tuple[int, float, float]]]
    rewards: ClassVar[tuple[float, float]]
    full: ClassVar[Mapping[str, float]] = {}

    @classmethod
    def of(cls, model: mj.MjModel, nose: NoseForm = "inverse") -> Self:
        """The rules for a compiled arena.

        Args:
          model: of the arena.
          nose: the form of Eq. 3, for robots that have a nose.

        Raises:
          KeyError: the arena lacks a sensor.
        """
        del nose
        return cls(SensorLayout.of(model))

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
    rewards: ClassVar = (-1.0, 0.0)

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
    rewards: ClassVar = (0.0, 1.0)
    full: ClassVar = {"nose": Nose.odour, "reward": Nose.odour}

    @classmethod
    def of(cls, model: mj.MjModel, nose: NoseForm = "inverse") -> Self:
        """The rules for a compiled arena, whose spot has the size that counts as inside."""
        radius = Dimensions.of(model).spot_radius
        return cls(SensorLayout.of(model), Nose(spot_radius=radius, form=nose))

    def observations(self, sensordata: np.ndarray) -> dict[str, np.ndarray]:
        """`nose` (..., 1): Eq. 3."""
        return {"nose": self.reward(sensordata)[..., None]}

    def reward(self, sensordata: np.ndarray) -> np.ndarray:
        """The nose signal, in [0, 1)."""
        return self.nose.signal(sensordata[..., self.layout.smell])

    def event(self, sensordata: np.ndarray) -> np.ndarray:
        """Whether the nose is inside the spot."""
        return self.nose.inside(sensordata[..., self.layout.smell])


def random_poses(random: Random, dimensions: Dimensions, count: int) -> np.ndarray:
    """Draws poses uniformly over the arena, clear of walls and obstacles by a centimetre.

    Args:
      random: the random stream to draw from.
      dimensions: of the arena and the robot.
      count: how many.

    Returns:
      x, y in metres and heading in radians, shape (count, 3).
    """
    clear = dimensions.radius + 0.01
    high = np.array([dimensions.half_length - clear, dimensions.half_width - clear, np.pi])
    poses = random.uniform(-high, high, (count, 3))
    obstacles = np.reshape(dimensions.obstacles, (-1, 3))
    while True:
        apart = np.hypot(*(poses[:, None, :2] - obstacles[:, :2]).transpose(2, 0, 1))
        blocked = (apart < obstacles[:, 2] + clear).any(axis=1)
        if not blocked.any():
            return poses
        poses[blocked] = random.uniform(-high, high, (int(blocked.sum()), 3))


def random_spots(random: Random, dimensions: Dimensions, count: int) -> np.ndarray:
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


@dataclasses.dataclass(frozen=True)
class Start:
    """Where episodes start.

    Attributes:
      robot: x, y in metres and heading in radians; a corner of the paper's, which the robot
        looks into; None draws a pose anew for every episode.
      spot: x, y of its centre in metres; a corner; None draws a place for every episode.
    """

    robot: tuple[float, float, float] | Corner | None = None
    spot: tuple[float, float] | Corner | None = None

    def __post_init__(self) -> None:
        """Raises ValueError where a place makes no sense."""
        for name, length in (("robot", 3), ("spot", 2)):
            place = getattr(self, name)
            if isinstance(place, str):
                if place not in CORNERS:
                    raise ValueError(f"{name} must be one of {list(CORNERS)}, got {place!r}")
            elif place is not None:
                if np.shape(place) != (length,) or not np.isfinite(place).all():
                    raise ValueError(f"{name} must be {length} finite numbers, got {place!r}")

    def draw(self, random: Random, dimensions: Dimensions) -> tuple[np.ndarray, np.ndarray]:
        """Returns a robot's pose, shape (3,), and a spot, shape (2,): the pose is drawn first."""
        robot = CORNERS[self.robot] if isinstance(self.robot, str) else self.robot
        spot = CORNERS[self.spot][:2] if isinstance(self.spot, str) else self.spot
        if robot is None:
            robot = random_poses(random, dimensions, 1)[0]
        if spot is None:
            spot = random_spots(random, dimensions, 1)[0]
        return np.asarray(robot, dtype=float), np.asarray(spot, dtype=float)


def checked_actions(actions: Any, shape: tuple[int, ...], limit: float) -> np.ndarray:
    """Motor values for actions in [-limit, limit], of the same shape.

    Args:
      actions: left and right; values beyond the limits are clipped.
      shape: that they must have, (..., 2).
      limit: the action that is motor value 0.5.

    Raises:
      ValueError: the actions have another shape, or are not finite.
    """
    actions = np.asarray(actions, dtype=float)
    if actions.shape != shape or not np.isfinite(actions).all():
        raise ValueError(
            f"an action is two finite motor values, shape {shape} in all; "
            f"got shape {actions.shape}: {actions!r}"
        )
    return np.clip(actions, -limit, limit) * (0.5 / limit)


class Task(base.Task):
    """A task of the arena: starts, signals as observations, two motors as actions.

    Attributes:
      rules: what the robot senses and is rewarded for.
      start: where episodes start.
      limit: actions lie in [-limit, limit]; the ends are motor values -0.5 and 0.5.
      spot_steps: control steps after which the spot jumps, again and again, to a place drawn
        at random; 0 for never.
    """

    def __init__(
        self,
        rules: Rules,
        *,
        start: Start | None = None,
        limit: float = 0.5,
        spot_steps: int = 0,
        random: Random | int | None = None,
    ) -> None:
        """Makes a task.

        Args:
          rules: what the robot senses and is rewarded for.
          start: where episodes start; None draws all of it.
          limit: actions lie in [-limit, limit].
          spot_steps: control steps between two jumps of the spot; 0 for a spot that stays.
          random: a random stream, a seed for one, or None for a seed of the machine's.
        """
        super().__init__(random=None if isinstance(random, np.random.Generator) else random)
        if isinstance(random, np.random.Generator):
            self.reseed(random)
        self.rules = rules
        self.start = start or Start()
        self.limit = limit
        self.spot_steps = spot_steps
        self._steps = 0
        self._shell: np.ndarray | None = None

    def reseed(self, random: Random) -> None:
        """From now on draws from another random stream."""
        self._random = random

    def action_spec(self, physics: Physics) -> specs.BoundedArray:
        """Returns the bounds of the motors, left and right."""
        del physics
        high = np.full(2, self.limit)
        return specs.BoundedArray(high.shape, np.float64, -high, high, name="motors")

    def initialize_episode(self, physics: Physics) -> None:
        """Places robot and spot."""
        robot, spot = self.start.draw(self.random, physics.dimensions)
        physics.place_robot(*robot)
        physics.place_spot(*spot)
        self._steps = 0
        super().initialize_episode(physics)

    def before_step(self, action: np.ndarray, physics: Physics) -> None:
        """Sets the motors, and lets the spot jump when it is time.

        Raises:
          ValueError: the action is not two finite numbers.
        """
        physics.set_control(checked_actions(action, (2,), self.limit))
        if self.spot_steps and self._steps and self._steps % self.spot_steps == 0:
            physics.place_spot(*random_spots(self.random, physics.dimensions, 1)[0])
        self._steps += 1

    def get_observation(self, physics: Physics) -> collections.OrderedDict[str, np.ndarray]:
        """Returns the sensor signals by name, each of shape (n,)."""
        observations = self.rules.observations(physics.data.sensordata[None])
        return collections.OrderedDict((name, value[0]) for name, value in observations.items())

    def observation_spec(self, physics: Physics) -> collections.OrderedDict[str, Any]:
        """Returns the bounds of every observation."""
        del physics
        return collections.OrderedDict(
            (name, specs.BoundedArray((length,), np.float64, low, high, name=name))
            for name, (length, low, high) in self.rules.shapes.items()
        )

    def get_reward(self, physics: Physics) -> float:
        """Returns the reward of the rules."""
        return float(self.rules.reward(physics.data.sensordata[None])[0])

    def after_step(self, physics: Physics) -> None:
        """Colours the robot's shell by the reward, where `visualize_reward` asks for it."""
        if self._visualize_reward:
            reward = abs(self.get_reward(physics))
            highlight = np.array([0.95, 0.25, 0.15, 1.0])
            shell = self._shell
            if shell is None:
                shell = self._shell = physics.named.model.mat_rgba["musebot/shell"].copy()
            physics.named.model.mat_rgba["musebot/shell"] = (
                reward * highlight + (1 - reward) * shell
            )


class Environment(control.Environment):
    """dm_control's, with bounds on rewards and flat observations, and exactly limited episodes."""

    def __init__(self, physics: Physics, task: Task, **settings: Any) -> None:
        """Makes an environment with the keywords of `dm_control.rl.control.Environment`."""
        # legacy_step=False: plain mj_step, as the batch's rollout does, so that both agree.
        settings = {"control_timestep": CONTROL_TIMESTEP, "legacy_step": False} | settings
        super().__init__(physics, task, **settings)
        # 100 s / (14 * 0.1 s / 14) is 1000.0000000000001, a step too many.
        self._step_limit = round(self._step_limit, 6)

    def observation_spec(self) -> Any:
        """Returns the bounds of every observation, or of all in one array if they are flat."""
        named = self.task.observation_spec(self.physics)
        if not self._flat_observation:
            return named
        low, high = (
            np.concatenate(
                [np.broadcast_to(getattr(spec, end), spec.shape) for spec in named.values()]
            )
            for end in ("minimum", "maximum")
        )
        name = control.FLAT_OBSERVATION_KEY
        spec = specs.BoundedArray(low.shape, np.float64, low, high, name=name)
        return collections.OrderedDict([(name, spec)])

    def reward_spec(self) -> specs.BoundedArray:
        """Returns the bounds of the reward."""
        return specs.BoundedArray((), float, *self.task.rules.rewards, name="reward")
