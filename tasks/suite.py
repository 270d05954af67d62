"""The table of all tasks, and what dm_control's users expect of a suite made of it.

A task is a row: rules, edits of the arena's model, the range of its actions, the length of its
episodes. Every door opens the same rows: `load`, `make_batch`, and Gymnasium's.
"""

from __future__ import annotations

import dataclasses
import inspect
import sys
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import mujoco as mj
import numpy as np
from dm_control import suite as dm_suite
from dm_control.mujoco.wrapper import MjModel
from dm_control.rl import control
from dm_control.utils import containers

from ..models import add_noses, add_obstacles, add_velocity, arena_spec, hide_spot
from .arena import (
    CONTROL_TIMESTEP,
    Environment,
    Physics,
    Rules,
    SpotFindingRules,
    Start,
    Task,
    WallAvoidanceRules,
)
from .batch import Batch
from .sensors import NoseForm
from .variants import DrivingRules, SpotAmongWallsRules, TwoNosesRules, UnitWallAvoidanceRules

DOMAIN = "arena"
FOREIGN_DOMAIN = "musebot_arena"  # among dm_control's own, after `register`

Edit = Callable[[mj.MjSpec], None]


@dataclasses.dataclass(frozen=True)
class Row:
    """A task, as data.

    Attributes:
      rules: what the robot senses and is rewarded for.
      edits: what is done to the arena's model, in order.
      tag: "paper" for the paper's tasks; "benchmarking" for those that keep dm_control's
        contract: actions in [-1, 1], rewards in [0, 1], episodes of 1,000 steps.
      limit: actions lie in [-limit, limit]; the ends are motor values -0.5 and 0.5.
      time_limit: of an episode, in seconds.
      spot_seconds: after which the spot jumps, again and again; 0 for never.
    """

    rules: type[Rules]
    edits: tuple[Edit, ...] = ()
    tag: str = "benchmarking"
    limit: float = 1.0
    time_limit: float = 100.0
    spot_seconds: float = 0.0

    def spec(self, motor_speed: float | None = None, edits: Sequence[Edit] = ()) -> mj.MjSpec:
        """The task's arena (see `models.arena_spec`), with more edits after the task's own."""
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
        """That say how the task is set up, whichever the door: only a robot with a nose has one."""
        return ["robot", "spot", *(["nose"] if issubclass(self.rules, SpotFindingRules) else [])]


_ENDLESS = float("inf")

TASKS: Mapping[str, Row] = {
    "wall_avoidance": Row(WallAvoidanceRules, (hide_spot,), "paper", 0.5, _ENDLESS),
    "spot_finding": Row(SpotFindingRules, (), "paper", 0.5, _ENDLESS),
    "wall_avoidance_unit": Row(UnitWallAvoidanceRules, (hide_spot,)),
    "wall_avoidance_obstacles": Row(DrivingRules, (hide_spot, add_obstacles, add_velocity)),
    "spot_finding_unit": Row(SpotFindingRules),
    "spot_finding_two_noses": Row(TwoNosesRules, (add_noses,)),
    "spot_finding_walls": Row(SpotAmongWallsRules),
    "spot_finding_jumping": Row(SpotFindingRules, spot_seconds=20.0),
}


def make_batch(
    task_name: str,
    robots: int,
    *,
    nose: NoseForm = "inverse",
    motor_speed: float | None = None,
    edits: Sequence[Edit] = (),
    threads: int = 0,
) -> Batch:
    """Returns robots in lockstep, each alone in the arena, sensing what the task lets it.

    Where robots and spots stand, and when a spot jumps, is up to whoever drives the batch.

    Args:
      task_name: a task of the table.
      robots: how many.
      nose: the form of Eq. 3.
      motor_speed: speed of a wheel at motor value 0.5, in metres a second; None for the
        robot's own.
      edits: done to the arena's model after the task's own.
      threads: that step the physics; 0 for the calling thread. Results do not depend on it.

    Raises:
      ValueError: there is no such task, or a number makes no sense.
    """
    row = row_of(task_name)
    model = row.spec(motor_speed, edits).compile()
    return Batch(model, row.rules.of(model, nose), robots, threads=threads)


def make_environment(
    task_name: str,
    *,
    robot: Any = None,
    spot: Any = None,
    nose: NoseForm = "inverse",
    time_limit: float | None = None,
    random: np.random.RandomState | np.random.Generator | int | None = None,
    environment_kwargs: Mapping[str, Any] | None = None,
) -> Environment:
    """Returns the dm_control environment of a task.

    Args:
      task_name: a task of the table.
      robot: where it starts: x, y in metres and heading in radians; "upper_left" or
        "upper_right" for the paper's corners; None draws it anew for every episode.
      spot: where the spot lies: x, y in metres; or a corner; or None, likewise.
      nose: the form of Eq. 3.
      time_limit: of an episode, in seconds; None for the task's own.
      random: a random stream, a seed for one, or None for a seed of the machine's.
      environment_kwargs: keywords of `dm_control.rl.control.Environment`.

    Raises:
      TypeError: an environment keyword is unknown.
      ValueError: there is no such task, or a value makes no sense.
    """
    row = row_of(task_name)
    settings = dict(environment_kwargs or {})
    check_keywords("the environment", settings, _environment_keywords())
    physics = Physics.from_model(MjModel(row.spec().compile()))
    rules = row.rules.of(physics.model.ptr, nose)
    task = Task(
        rules,
        start=Start(robot, spot),
        limit=row.limit,
        spot_steps=row.spot_steps,
        random=random,
    )
    settings.setdefault("time_limit", row.time_limit if time_limit is None else time_limit)
    return Environment(physics, task, **settings)


def _factory(task_name: str, row: Row) -> Callable[..., Environment]:
    """What dm_control's suites keep of a task: a function of its name."""
    allowed = [*row.keywords, "environment_kwargs", "random", "time_limit"]

    def make(**kwargs: Any) -> Environment:
        check_keywords(f"task {task_name!r}", kwargs, allowed)
        return make_environment(task_name, **kwargs)

    make.__name__ = task_name
    return make


SUITE = containers.TaggedTasks()
for _name, _task in TASKS.items():
    SUITE.add(_task.tag)(_factory(_name, _task))

ALL_TASKS = tuple((DOMAIN, task) for task in sorted(SUITE))
PAPER = tuple((DOMAIN, task) for task in sorted(SUITE.tagged("paper")))
BENCHMARKING = tuple((DOMAIN, task) for task in sorted(SUITE.tagged("benchmarking")))
TASKS_BY_DOMAIN = {DOMAIN: tuple(sorted(SUITE))}


def load(
    domain_name: str,
    task_name: str,
    task_kwargs: Mapping[str, Any] | None = None,
    environment_kwargs: Mapping[str, Any] | None = None,
    visualize_reward: bool = False,
) -> Environment:
    """Returns an environment, with the signature of `dm_control.suite.load`.

    Args:
      domain_name: "arena".
      task_name: see `ALL_TASKS`.
      task_kwargs: keywords of the task: `random`, `time_limit`, `robot`, `spot`, `nose` (see
        `make_environment`).
      environment_kwargs: keywords of `dm_control.rl.control.Environment`.
      visualize_reward: colours the robot by its reward.

    Raises:
      TypeError: a keyword is unknown.
      ValueError: there is no such domain or task, or a value makes no sense.
    """
    if domain_name != DOMAIN:
        raise ValueError(
            f"Domain {domain_name!r} does not exist: domain must be one of {[DOMAIN]}, "
            f"got {domain_name!r}"
        )
    row_of(task_name)
    kwargs = dict(task_kwargs or {})
    if environment_kwargs is not None:
        kwargs["environment_kwargs"] = environment_kwargs
    environment = SUITE[task_name](**kwargs)
    environment.task.visualize_reward = visualize_reward
    return environment


def register() -> None:
    """Puts the tasks among dm_control's own, as the domain "musebot_arena".

    From then on `dm_control.suite.load("musebot_arena", "wall_avoidance")` works, in this
    process. dm_control has no public way in: this adds to its private table of domains, and
    leaves its `ALL_TASKS` and other lists as they are.
    """
    dm_suite._DOMAINS[FOREIGN_DOMAIN] = sys.modules[__name__]


def row_of(task_name: str) -> Row:
    """A row of the table.

    Raises:
      ValueError: there is no such task.
    """
    if task_name not in TASKS:
        raise ValueError(
            f"Level {task_name!r} does not exist in domain {DOMAIN!r}: task must be one of "
            f"{sorted(TASKS)}, got {task_name!r}"
        )
    return TASKS[task_name]


def _environment_keywords() -> list[str]:
    return [
        name
        for name in inspect.signature(control.Environment).parameters
        if name not in ("physics", "task")
    ]


def check_keywords(whose: str, given: Mapping[str, Any], allowed: list[str]) -> None:
    """Raises TypeError where a keyword is not among those allowed."""
    unknown = sorted(set(given) - set(allowed))
    if unknown:
        raise TypeError(f"{whose} takes the keywords {sorted(allowed)}, got {unknown}")
