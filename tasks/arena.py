"""The arena in dm_control: its physics, its task, its environment and the definition of a task."""

from __future__ import annotations

import collections
import dataclasses
import functools
import inspect
from collections.abc import Callable, Mapping, Sequence
from typing import Any, TypedDict, Unpack

import mujoco as mj
import numpy as np
from dm_control import mujoco
from dm_control.mujoco.engine import Contexts
from dm_control.mujoco.wrapper import MjModel, MjrContext
from dm_control.rl import control
from dm_control.suite import base
from dm_control.utils import containers
from dm_env import specs

from ..models.arena import Dimensions, arena_spec, robot_pose, robot_qpos
from ..models.rendering import fit_buffer, open_context
from .rules import Rules
from .sensors import NoseForm
from .starts import Corner, Random, Start, random_spots

CONTROL_TIMESTEP = 0.1  # [s]; the cycle time of section 3
SUITE = containers.TaggedTasks()  # every task's factory, added by wall_avoidance, spot_finding

Edit = Callable[[mj.MjSpec], None]


class Physics(mujoco.Physics):
    """MuJoCo's physics of the arena, with named queries.

    After `step`, `sensordata` shows the start of the last substep (docs/physics.md), as in the
    batch of robots.
    """

    @functools.cached_property
    def dimensions(self) -> Dimensions:
        """Dimensions of the robot, the arena and the spot."""
        return Dimensions.of(self.model.ptr)

    def robot_pose(self) -> np.ndarray:
        """Returns x, y in [m] and heading in [rad], shape (3,)."""
        return robot_pose(self.data.qpos)

    def spot_position(self) -> np.ndarray:
        """Returns x, y of the spot's centre in [m], shape (2,)."""
        return self.data.mocap_pos[0, :2].copy()

    def place_robot(self, x: float, y: float, heading: float) -> None:
        """Places the robot at rest at x, y in [m], with a heading in [rad]."""
        self.data.qpos[:] = robot_qpos(np.array([x, y, heading]))
        self.data.qvel[:] = 0
        self.data.ctrl[:] = 0

    def place_spot(self, x: float, y: float) -> None:
        """Places the spot's centre at x, y in [m]; sensors show it from the next step on."""
        self.data.mocap_pos[0, :2] = x, y

    def render(self, height: int = 240, width: int = 320, *args: Any, **kwargs: Any) -> np.ndarray:
        """Returns dm_control's picture of a camera; the model's buffer grows to its size.

        Args:
          height: Height of the picture in pixels.
          width: Width of the picture in pixels.
          *args: See `dm_control.mujoco.Physics.render`.
          **kwargs: See `dm_control.mujoco.Physics.render`.

        Raises:
          RuntimeError: OpenGL cannot be opened here.
        """
        if fit_buffer(self.model.ptr, width, height) and self._contexts:
            size = self.model.vis.global_
            with self._contexts.gl.make_current() as executor:
                context = self._contexts.mujoco.ptr
                executor.call(mj.mjr_resizeOffscreen, size.offwidth, size.offheight, context)
        return super().render(height, width, *args, **kwargs)

    def _make_rendering_contexts(self) -> None:
        size = self.model.vis.global_
        gl = open_context(size.offwidth, size.offheight)
        self._contexts = Contexts(gl=gl, mujoco=MjrContext(self.model, gl))


def checked_actions(actions: Any, shape: tuple[int, ...], limit: float) -> np.ndarray:
    """Returns the motor values of actions in [-limit, limit], in the same shape.

    Args:
      actions: Left and right action; values beyond the limits are clipped.
      shape: Required shape, (..., 2).
      limit: Action that corresponds to motor value 0.5.

    Raises:
      ValueError: The actions have another shape, or are not finite.
    """
    actions = np.asarray(actions, dtype=float)
    if actions.shape != shape or not np.isfinite(actions).all():
        raise ValueError(
            f"an action must be two finite motor values, shape {shape} in all, "
            f"got shape {actions.shape}: {actions!r}"
        )
    return np.clip(actions, -limit, limit) * (0.5 / limit)


class Task(base.Task):
    """A task of the arena: sensor signals as observations, two motors as actions.

    Attributes:
      rules: Observations and reward of the task.
      start: Places of robot and spot at the start of an episode.
      limit: Largest action, which corresponds to motor value 0.5.
      spot_steps: Number of control steps between two jumps of the spot to a random place; 0 for a
        spot that stays.
    """

    def __init__(
        self,
        rules: Rules,
        *,
        start: Start,
        limit: float,
        spot_steps: int,
        random: Random | int | None,
    ) -> None:
        """Initialises the task.

        Args:
          rules: Observations and reward of the task.
          start: Places of robot and spot at the start of an episode.
          limit: Largest action, which corresponds to motor value 0.5.
          spot_steps: Number of control steps between two jumps of the spot; 0 for a spot that
            stays.
          random: Random stream, or its seed; None for a seed of the operating system.
        """
        super().__init__(random=None if isinstance(random, np.random.Generator) else random)
        if isinstance(random, np.random.Generator):
            self.reseed(random)
        self.rules = rules
        self.start = start
        self.limit = limit
        self.spot_steps = spot_steps
        self._steps = 0
        self._shell: np.ndarray | None = None

    def reseed(self, random: Random) -> None:
        """Replaces the random stream."""
        self._random = random

    def action_spec(self, physics: Physics) -> specs.BoundedArray:
        """Returns the bounds of the two actions, left and right."""
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
        """Sets the motors, and moves the spot when a jump is due.

        Raises:
          ValueError: The action is not two finite numbers.
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
        """Returns the task's reward for the current measurements."""
        return float(self.rules.reward(physics.data.sensordata[None])[0])

    def after_step(self, physics: Physics) -> None:
        """Colours the robot's shell by the reward if `visualize_reward` is set."""
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
    """dm_control's environment with bounded rewards, flat observation specs, exact time limits."""

    def __init__(self, physics: Physics, task: Task, **settings: Any) -> None:
        """Initialises with the keywords of `dm_control.rl.control.Environment`."""
        # legacy_step=False: plain mj_step, as in the batch's rollout, so that both agree.
        settings = {"control_timestep": CONTROL_TIMESTEP, "legacy_step": False} | settings
        super().__init__(physics, task, **settings)
        # 100 s / (14 * 0.1 s / 14) is 1000.0000000000001, one step too many.
        self._step_limit = round(self._step_limit, 6)

    @property
    def physics(self) -> Physics:
        """Physics of the arena."""
        return self._physics

    @property
    def task(self) -> Task:
        """The task."""
        return self._task

    def observation_spec(self) -> Any:
        """Returns the bounds of every observation, or of the one flat array if requested."""
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


class Settings(TypedDict, total=False):
    """Keywords of every task's factory.

    Attributes:
      robot: Start of the robot: x, y in [m] and heading in [rad]; or a corner, which the robot
        faces; None (default) draws a pose for every episode.
      spot: Centre of the spot: x, y in [m]; or a corner; None (default) draws a place for every
        episode.
      nose: Form of Eq. 3, "inverse" (default) or "printed"; only for robots with a nose.
      time_limit: Length of an episode in [s]; None (default) for the task's own.
      random: Random stream, or its seed; None (default) for a seed of the operating system.
      environment_kwargs: Keywords of `dm_control.rl.control.Environment`.
    """

    robot: tuple[float, float, float] | Corner | None
    spot: tuple[float, float] | Corner | None
    nose: NoseForm
    time_limit: float | None
    random: Random | int | None
    environment_kwargs: Mapping[str, Any] | None


@dataclasses.dataclass(frozen=True)
class TaskDefinition:
    """A task as data, from which every interface makes its environments and batches.

    The defaults are dm_control's contract for benchmarking: actions in [-1, 1] and episodes of
    1,000 steps.

    Attributes:
      name: Name of the task and of its factory.
      rules: Observations and reward of the task.
      edits: Edits of the arena's model, in order.
      limit: Largest action, which corresponds to motor value 0.5.
      time_limit: Length of an episode in [s].
      spot_seconds: Time between two jumps of the spot in [s]; 0 for a spot that stays.
    """

    name: str
    rules: type[Rules]
    edits: tuple[Edit, ...] = ()
    limit: float = 1.0
    time_limit: float = 100.0
    spot_seconds: float = 0.0

    def spec(self, motor_speed: float | None = None, edits: Sequence[Edit] = ()) -> mj.MjSpec:
        """Returns the task's arena.

        Args:
          motor_speed: Speed of a wheel at motor value 0.5 in [m/s]; None for that of the model.
          edits: Further edits of the arena's model, after the task's own.
        """
        spec = arena_spec(motor_speed=motor_speed)
        for edit in (*self.edits, *edits):
            edit(spec)
        return spec

    @property
    def spot_steps(self) -> int:
        """Control steps between two jumps of the spot; 0 for a spot that stays."""
        return round(self.spot_seconds / CONTROL_TIMESTEP)

    @property
    def keywords(self) -> list[str]:
        """Keywords that every interface accepts for this task."""
        return ["robot", "spot", *(["nose"] if self.rules.has_nose else [])]

    def environment(self, **settings: Unpack[Settings]) -> Environment:
        """Returns the dm_control environment of the task.

        Args:
          **settings: See `Settings`.

        Raises:
          TypeError: A keyword is unknown.
          ValueError: A value is out of range.
        """
        allowed = [*self.keywords, "environment_kwargs", "random", "time_limit"]
        check_keywords(f"task {self.name!r}", settings, allowed)
        kwargs = dict(settings.get("environment_kwargs") or {})
        check_keywords("the environment", kwargs, _environment_keywords())
        physics = Physics.from_model(MjModel(self.spec().compile()))
        task = Task(
            self.rules.of(physics.model.ptr, settings.get("nose", "inverse")),
            start=Start(settings.get("robot"), settings.get("spot")),
            limit=self.limit,
            spot_steps=self.spot_steps,
            random=settings.get("random"),
        )
        time_limit = settings.get("time_limit")
        kwargs.setdefault("time_limit", self.time_limit if time_limit is None else time_limit)
        return Environment(physics, task, **kwargs)


def check_keywords(whose: str, given: Mapping[str, Any], allowed: Sequence[str]) -> None:
    """Raises TypeError if a given keyword is not allowed."""
    unknown = sorted(set(given) - set(allowed))
    if unknown:
        raise TypeError(f"{whose} takes the keywords {sorted(allowed)}, got {unknown}")


def _environment_keywords() -> list[str]:
    return [
        name
        for name in inspect.signature(control.Environment).parameters
        if name not in ("physics", "task")
    ]
