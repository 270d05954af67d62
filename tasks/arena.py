"""The arena in dm_control: its task, its environment and the definition of a task."""

from __future__ import annotations

import collections
import dataclasses
import json
import math
import zlib
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypedDict, Unpack

import dm_env
import mujoco as mj
import numpy as np

from ..models.physics import INTEGRATION, Physics  # first: imports dm_control without its warnings

# isort: split
from dm_control.mujoco.wrapper import MjModel
from dm_control.rl import control
from dm_control.suite import base
from dm_control.utils import containers
from dm_env import specs

from ..fields import Checked, number
from ..models.arena import ARENA_XML, Dimensions, arena_spec
from .episode import (
    CONTROL_TIMESTEP,
    Episode,
    Stage,
    check_counts,
    check_keywords,
    check_stage,
    check_state,
    check_stream_state,
    seconds,
    set_stream_state,
    stream_state,
)
from .rules import Rules
from .sensors import NoseForm
from .starts import Corner, Random, Start, random_spots
from .world import World

if TYPE_CHECKING:
    from .lives import Life, Phase

SHELL = "musebot_shell"  # material that `visualize_reward` colours
SUITE = containers.TaggedTasks()  # every task's factory

Edit = Callable[[mj.MjSpec], None]


class Task(base.Task):
    """A task of the arena: sensor signals as observations, two motors as actions.

    Attributes:
      rules: Observations and reward of the task in the present world.
      episode: How an episode starts, how long it lasts, and the limits of its actions.
      start: Places of robot and spot at the start of the next episode.
      steps: Number of control steps of this episode so far.
      world: World of the present phase in a life; the default world in ordinary episodes.
      ended: Rules and measurements with which the last control step ended, before a new stretch of
        a life began.
    """

    def __init__(self, rules: Rules, episode: Episode, random: Random | int | None) -> None:
        """Initialises the task; `random` is a stream, its seed, or None for an arbitrary seed."""
        super().__init__(random=None if isinstance(random, np.random.Generator) else random)
        if isinstance(random, np.random.Generator):
            self.reseed(random)
        self.rules = self._task_rules = rules
        self.world = World()
        self.episode = episode
        self.start = episode.start
        self.steps = 0
        self.ended = rules, np.zeros((1, 0))
        self._shell: np.ndarray | None = None

    def reseed(self, random: Random) -> None:
        """Replaces the random stream."""
        self._random = random

    def action_spec(self, physics: Physics) -> specs.BoundedArray:
        del physics
        high = np.full(2, self.episode.limit)
        return specs.BoundedArray(high.shape, np.float64, -high, high, name="motors")

    def initialize_episode(self, physics: Physics) -> None:
        self.steps = 0
        if leg := self.episode.leg_from(0):
            physics.place_robot(0.0, 0.0, 0.0)
            self._begin(leg.phase, physics)
            return
        robot, spot = self.start.draw(self.random, physics.dimensions)
        physics.place_robot(*robot)
        physics.place_spot(*spot)

    def _begin(self, phase: Phase, physics: Physics) -> None:
        """Begins a stretch of a life."""
        self.enter(phase.world, physics)
        spots, poses = phase.draw(self.random, physics.dimensions, 1)
        if spots is not None:
            physics.place_spot(*spots[0])
        if poses is not None:
            physics.place_robot(*poses[0])
            physics.forward()  # the robot senses where it is now

    def enter(self, world: World, physics: Physics) -> None:
        """Changes the world, see `Robots.enter`."""
        self.rules = world.rules(self._task_rules, physics.dimensions.nose)
        self.world = world

    def before_step(self, action: np.ndarray, physics: Physics) -> None:
        """Sets the motors, and moves the spot when a jump is due; see `Episode.motors`."""
        physics.set_control(self.world.motors(self.episode.motors(action)))
        if self.episode.jumps(self.steps):
            physics.place_spot(*random_spots(self.random, physics.dimensions, 1)[0])
        self.steps += 1

    def get_observation(self, physics: Physics) -> collections.OrderedDict[str, np.ndarray]:
        """Returns the sensor signals by name, each of shape (n,)."""
        observations = self.rules.observations(physics.readings)
        # Copies: rules may return views of the measurements, which the next step overwrites.
        copies = ((name, np.array(values[0], float)) for name, values in observations.items())
        return collections.OrderedDict(copies)

    def observation_spec(self, physics: Physics) -> collections.OrderedDict[str, Any]:
        del physics
        return collections.OrderedDict(
            (name, specs.BoundedArray((length,), np.float64, low, high, name=name))
            for name, (length, low, high) in self.rules.shapes.items()
        )

    def get_reward(self, physics: Physics) -> float:
        """Returns the reward of the last control step, in the world in which it took place."""
        del physics
        rules, readings = self.ended
        return float(rules.checked_reward(readings).item())

    def after_step(self, physics: Physics) -> None:
        """Checks the physics; begins the next stretch of a life when it is due."""
        self.end_step(physics)
        if leg := self.episode.leg_from(self.steps):
            self._begin(leg.phase, physics)

    def end_step(self, physics: Physics) -> None:
        """Checks the physics, see `Physics.check_sound`; shows the reward if that is wanted."""
        physics.check_sound()
        self.ended = self.rules, physics.readings.copy()
        if self._visualize_reward:
            largest = max(map(abs, self.rules.rewards)) or 1.0
            reward = abs(self.get_reward(physics)) / largest
            highlight = np.array([0.95, 0.25, 0.15, 1.0])
            colours = physics.named.model.mat_rgba
            shell = self._shell
            if shell is None:
                shell = self._shell = colours[SHELL].copy()
            colours[SHELL] = reward * highlight + (1 - reward) * shell


class Environment(control.Environment):
    """dm_control's environment, with exact copies, exact time limits, and saved states.

    As dm_env requires, the first `step`, and the first after an episode's end, act as `reset`.
    """

    def __init__(self, physics: Physics, task: Task, flat_observation: bool = False) -> None:
        """Initialises the environment; `task.episode` has the length of an episode."""
        super().__init__(
            physics,
            task,
            control_timestep=CONTROL_TIMESTEP,
            flat_observation=flat_observation,
        )
        self._step_limit = task.episode.steps
        self.stage: Stage = "new"

    def reset(self, *, options: Mapping[str, Any] | None = None) -> dm_env.TimeStep:
        """Starts an episode; `options` may hold `robot` and `spot`, places that replace the task's.

        Raises TypeError for an unknown option, ValueError for a place outside the arena or in an
        obstacle, RuntimeError where the environment is closed.
        """
        check_stage(self.stage, "closed")
        self.task.start = self.task.episode.start_with(options)
        self.stage = "failed"  # until the pose has been found stable
        timestep = super().reset()
        # Not in `initialize_episode`, which is called before the pose is in the sensors.
        self.task.end_step(self.physics)
        self.stage = "running"
        return timestep

    def step(self, action: Any) -> dm_env.TimeStep:
        """Simulates 0.1 s for a left and right action, shape (2,), clipped to `action_spec`.

        Raises:
          ValueError: The action is not two finite numbers, or the reward is not as `rules` declare.
          PhysicsError: The simulation became unstable; then `reset` must be called.
          RuntimeError: The environment is closed or has failed.
        """
        check_stage(self.stage, "failed", "closed")
        try:
            return super().step(action)
        except control.PhysicsError:
            self.stage = "failed"
            raise

    def close(self) -> None:
        """Frees the renderer and the physics; the environment cannot be used any more."""
        if self.stage != "closed":
            self.stage = "closed"
            self.physics.free()

    def get_state(self) -> dict[str, Any]:
        """Returns everything that the next steps depend on; RuntimeError if closed or failed."""
        check_stage(self.stage, "failed", "closed")
        return self._state()

    def _state(self) -> dict[str, Any]:
        return {
            "task": self.task.episode.task,
            "physics": self.physics.get_state(INTEGRATION),
            "sensordata": self.physics.data.sensordata.copy(),
            "steps": self.task.steps,
            "over": self._reset_next_step,
            "random": stream_state(self.task.random),
        }

    def check_state(self, state: Mapping[str, Any], random: Random) -> None:
        """Raises what `set_state` would raise, and changes nothing."""
        check_stage(self.stage, "closed")
        check_state(state, self._state())
        check_counts("steps", [state["steps"]], [self.task.episode.most_steps])
        check_stream_state(random, state["random"])
        self.physics.dimensions.check_standing(state["physics"][None], state["sensordata"])

    def set_state(self, state: Mapping[str, Any]) -> None:
        """Continues bit-exactly from what `get_state` of an environment of this task returned.

        Raises ValueError if the state is of another task, of another kind of random stream, or has
        the robot outside the arena; then nothing has changed. Raises RuntimeError if closed.
        """
        self.check_state(state, self.task.random)
        set_stream_state(self.task.random, state["random"])
        self.physics.restore(state["physics"], state["sensordata"])
        self.task.steps = self._step_count = state["steps"]
        self._reset_next_step = state["over"]
        episode = self.task.episode
        if episode.life:
            self.task.enter(episode.leg_of(self.task.steps).phase.world, self.physics)
        self.task.end_step(self.physics)
        self.stage = "running"

    @property
    def physics(self) -> Physics:
        return self._physics

    @property
    def task(self) -> Task:
        return self._task

    def observation_spec(self) -> Any:
        """Returns the bounds of every observation; of one array with `flat_observation`."""
        named = self.task.observation_spec(self.physics)
        if not self._flat_observation:
            return named
        name, (low, high) = control.FLAT_OBSERVATION_KEY, self.task.rules.bounds()
        spec = specs.BoundedArray(low.shape, np.float64, low, high, name=name)
        return collections.OrderedDict([(name, spec)])

    def reward_spec(self) -> specs.BoundedArray:
        return specs.BoundedArray((), float, *self.task.rules.rewards, name="reward")


class Settings(TypedDict, total=False):
    """Keyword arguments of `TaskDefinition.environment`, which makes a task's environment.

    Attributes:
      robot: Pose x, y in [m] and heading in [rad], or "upper_left" or "upper_right", a corner of
        the paper's arena; None (default) for random poses.
      spot: Centre x, y in [m], or a corner, see `robot`; None (default) for random places.
      nose: Form of Eq. 3, "inverse" (default) or "printed" (see `Nose`); only if the task has a
        nose.
      time_limit: Length of an episode in [s]; None (default) for the task's own.
      random: Random stream, or its seed; None (default) for a seed of the operating system.
      environment_kwargs: Dictionary with two optional keys: `flat_observation` (whether all signals
        are joined in one array) and `time_limit` (overrides the keyword `time_limit`).
    """

    robot: tuple[float, float, float] | Corner | None
    spot: tuple[float, float] | Corner | None
    nose: NoseForm
    time_limit: float | None
    random: Random | int | None
    environment_kwargs: Mapping[str, Any] | None


@dataclasses.dataclass(frozen=True)
class TaskDefinition(Checked):
    """A task as data, from which every interface makes its environments and batches.

    The defaults are dm_control's contract for benchmarking: actions in [-1, 1] and episodes of
    1,000 steps.

    Attributes:
      name: Name of the task, such as "wall_avoidance".
      rules: Subclass of `Rules` with the task's observations, reward and measured event.
      edits: Functions that change the arena's MjSpec in place, called in this order.
      limit: Bound of an action's two numbers: `limit` gives motor value 0.5, `-limit` gives -0.5.
      time_limit: Length of an episode in [s]; infinity for an episode without end.
      spot_seconds: Time between two jumps of the spot in [s], a multiple of 0.1; 0 for a spot that
        stays.
      model: MJCF file of the arena with its robot, see `models.arena.check_arena`.
      life: Life through which the robot passes in every episode; None for a task without phases.
    """

    name: str
    rules: type[Rules]
    edits: tuple[Edit, ...] = ()
    limit: float = number(1.0, 1e-6, 1e6)
    time_limit: float = number(100.0, CONTROL_TIMESTEP, math.inf, unit="s")
    spot_seconds: float = number(0.0, 0, 1e9, unit="s")
    model: str | Path = ARENA_XML
    life: Life | None = None

    def __post_init__(self) -> None:
        """Raises ValueError, with the field's name, for a value out of range."""
        super().__post_init__()
        if abs(self.spot_steps * CONTROL_TIMESTEP - self.spot_seconds) > 1e-9:
            raise ValueError(f"spot_seconds must be a multiple of 0.1 s, got {self.spot_seconds}")
        edits: Any = self.edits
        if not isinstance(edits, tuple | list) or not all(map(callable, edits)):
            raise ValueError(f"edits must be a tuple of functions on an arena, got {edits!r:.60}")

    def spec(self, motor_speed: float | None = None, edits: Sequence[Edit] = ()) -> mj.MjSpec:
        """Returns the task's arena, see `arena_spec`; further edits follow the task's own."""
        spec = arena_spec(self.model, motor_speed=motor_speed)
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
        places = [] if self.life else ["robot", "spot"]
        return [*places, *(["nose"] if self.rules.has_nose else [])]

    def environment(self, **settings: Unpack[Settings]) -> Environment:
        """Returns the task's dm_control environment; TypeError for an unknown keyword."""
        allowed = [*self.keywords, "environment_kwargs", "random", "time_limit"]
        check_keywords(f"task {self.name!r}", settings, allowed)
        kwargs = dict(settings.get("environment_kwargs") or {})
        # Others would change the physics, or the control step, which times the jumps of the spot.
        check_keywords("the environment", kwargs, ["flat_observation", "time_limit"])
        limits = kwargs.get("time_limit"), settings.get("time_limit"), self.time_limit
        limit = seconds(next(value for value in limits if value is not None))
        physics = Physics.from_model(MjModel(self.spec().compile()))
        start = Start(settings.get("robot"), settings.get("spot"))
        nose = settings.get("nose", "inverse")
        rules = self.rules.of(physics.model.ptr, nose)
        episode = self.episode(start, physics.dimensions, steps_until(limit), rules, nose)
        task = Task(rules, episode, settings.get("random"))
        return Environment(physics, task, bool(kwargs.get("flat_observation", False)))

    def episode(
        self, start: Start, dimensions: Dimensions, steps: float, rules: Rules, nose: NoseForm
    ) -> Episode:
        """Returns an episode of at most `steps` steps; ValueError if its life is impossible.

        Its name also tells forms of the smell apart, and lives of equal names.
        """
        name = self.name if nose == "inverse" else f"{self.name}, nose {nose}"
        if self.life:
            self.life.check(rules, dimensions)
            plain = json.loads(json.dumps(dataclasses.asdict(self.life)), parse_int=float)
            name += f", life {zlib.crc32(repr(plain).encode()):08x}"  # equal for equal lives
            steps = min(steps, sum(self.life.steps()))
        return Episode(name, start, dimensions, self.limit, self.spot_steps, steps, self.life)

    def of_life(self, life: Life) -> TaskDefinition:
        """Returns a copy of the task in which every episode is a whole life.

        Raises ValueError for a task in which the spot jumps.
        """
        if self.spot_seconds:
            raise ValueError(
                f"a life cannot have the task {self.name}, whose spot jumps: set every_minutes"
            )
        own: Any = {"name": f"life_{life.name}", "life": life, "limit": 1.0}
        return dataclasses.replace(self, **own, time_limit=math.inf, spot_seconds=0.0)


def steps_until(time_limit: float) -> float:
    """Returns the number of control steps of an episode whose length is given in [s].

    As in dm_control, the episode ends with the first step that reaches the limit.
    """
    steps = round(time_limit / CONTROL_TIMESTEP, 6)  # 3 * 0.1 is slightly more than 0.3
    return max(1, math.ceil(steps)) if math.isfinite(steps) else steps
