"""The table of all tasks, as dm_control environments and as batches in MuJoCo."""

from __future__ import annotations

import contextlib
import sys
import tomllib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Unpack

import mujoco
from dm_control import suite as dm_suite

from . import spot_finding, wall_avoidance
from .arena import SHELL, SUITE, Edit, Environment, Settings, TaskDefinition
from .batch import Batch
from .lives import LIVES, Life, life_from, life_named
from .sensors import NoseForm

DOMAIN = "arena"
LIFE_DOMAIN = "life"
FOREIGN_DOMAIN = "musebot_arena"  # name of the domain in dm_control's own suite, after `register`

TASKS: dict[str, TaskDefinition] = {}
_SUITE = {  # by dm_control's tag
    "paper": (wall_avoidance.PAPER, spot_finding.PAPER),
    "benchmarking": (
        wall_avoidance.UNIT,
        wall_avoidance.OBSTACLES,
        spot_finding.UNIT,
        spot_finding.TWO_NOSES,
        spot_finding.WALLS,
        spot_finding.JUMPING,
    ),
}


def add_task(definition: TaskDefinition, tag: str) -> None:
    """Adds a task to `TASKS`, and its factory to `SUITE`; replaces one of the same name."""
    name = definition.name

    def factory(**settings: Unpack[Settings]) -> Environment:
        return TASKS[name].environment(**settings)

    if name not in TASKS:
        factory.__name__ = name
        SUITE.add(tag)(factory)
    SUITE[name].__doc__ = definition.rules.__doc__
    TASKS[name] = definition


for _tag, _definitions in _SUITE.items():
    for _definition in _definitions:
        add_task(_definition, _tag)
TASKS[spot_finding.OR_DRIVING.name] = spot_finding.OR_DRIVING
ALL_TASKS = tuple((DOMAIN, task) for task in sorted(SUITE))
PAPER = tuple((DOMAIN, task) for task in sorted(SUITE.tagged("paper")))
BENCHMARKING = tuple((DOMAIN, task) for task in sorted(SUITE.tagged("benchmarking")))
TASKS_BY_DOMAIN = {DOMAIN: tuple(sorted(SUITE))}


def task_definition(task_name: str) -> TaskDefinition:
    """Returns a task of `TASKS` by its name; ValueError if there is none."""
    if not isinstance(task_name, str) or task_name not in TASKS:
        raise ValueError(
            f"task must be one of {sorted(TASKS)} in the domain {DOMAIN!r}, got {task_name!r:.60}"
        )
    return TASKS[task_name]


def life_definition(life: Any) -> TaskDefinition:
    """Returns the task whose episodes are one life: a name, the path of a TOML file, or a `Life`.

    Raises ValueError where there is none, OSError where a file cannot be read.
    """
    found = life
    if isinstance(life, str | Path) and Path(life).suffix == ".toml":
        found = life_from(tomllib.loads(Path(life).read_text(encoding="utf-8-sig")))
    elif isinstance(life, str):
        with contextlib.suppress(KeyError):
            found = life_named(life)
    if not isinstance(found, Life):
        raise ValueError(
            f"life must be one of {sorted(LIVES)}, a file ending in .toml, or a Life, "
            f"got {life!r:.60}"
        )
    return task_definition(found.task).of_life(found)


def load(
    domain_name: str,
    task_name: str,
    task_kwargs: Mapping[str, Any] | None = None,
    environment_kwargs: Mapping[str, Any] | None = None,
    visualize_reward: bool = False,
) -> Environment:
    """Returns a task's dm_control environment, see `musebot.load`."""
    domains = [DOMAIN, LIFE_DOMAIN]
    if domain_name not in domains:
        raise ValueError(
            f"Domain {domain_name!r:.60} does not exist: domain must be one of {domains}, "
            f"got {domain_name!r:.60}"
        )
    is_task = domain_name == DOMAIN
    definition = task_definition(task_name) if is_task else life_definition(task_name)
    kwargs: Any = dict(task_kwargs or {})
    if environment_kwargs is not None:
        kwargs["environment_kwargs"] = environment_kwargs
    environment = definition.environment(**kwargs)
    model, kind = environment.physics.model.ptr, mujoco.mjtObj.mjOBJ_MATERIAL
    if visualize_reward and mujoco.mj_name2id(model, kind, SHELL) < 0:
        raise ValueError(f"visualize_reward needs a robot with the material {SHELL!r}")
    environment.task.visualize_reward = visualize_reward
    return environment


def register() -> None:
    """Adds the tasks to dm_control's suite in this process, as the domain "musebot_arena".

    `dm_control.suite.load("musebot_arena", "wall_avoidance")` works from then on. dm_control has
    no public way to do this, so its private table of domains gets an entry; its `ALL_TASKS` and
    other lists stay as they are.
    """
    dm_suite._DOMAINS[FOREIGN_DOMAIN] = sys.modules[__name__]


def make_batch(
    task_name: str,
    robots: int,
    *,
    nose: NoseForm = "inverse",
    motor_speed: float | None = None,
    edits: Sequence[Edit] = (),
    threads: int = 0,
) -> Batch:
    """Returns robots in lockstep in MuJoCo, each alone in its arena, with a task's sensors.

    The caller places robots and spots, and moves a spot that jumps.

    Args:
      task_name: Name of a task, a key of `TASKS`.
      robots: Number of robots, B.
      nose: Form of Eq. 3, "inverse" or "printed", see `sensors.Nose`.
      motor_speed: Speed of a wheel at motor value 0.5 in [m/s]; None keeps the model's.
      edits: Further edits of the arena's model, after the task's own.
      threads: Number of threads that step the physics; 0 for the calling thread. Results do not
        depend on it.

    Raises:
      ValueError: There is no such task, or a value is out of range.
    """
    definition = task_definition(task_name)
    model = definition.spec(motor_speed, edits).compile()
    return Batch(model, definition.rules.of(model, nose), robots, threads=threads)
