"""What the robot senses and is rewarded for: dm_control tasks, and robots in lockstep."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from dm_control.rl import control

from ..models.kinematic import Kinematics
from . import arena
from .arena import CONTROL_TIMESTEP, Physics, SpotFinding, WallAvoidance
from .batch import Batch, Robots, silence_warnings, stop_timers
from .kinematic import KinematicBatch
from .senses import NoseForm

__all__ = [
    "ALL_TASKS",
    "CONTROL_TIMESTEP",
    "Batch",
    "KinematicBatch",
    "Physics",
    "Robots",
    "SpotFinding",
    "WallAvoidance",
    "load",
    "make_batch",
    "silence_warnings",
    "stop_timers",
]

_DOMAINS = {"arena": arena}

ALL_TASKS = tuple(
    (domain, task) for domain, module in _DOMAINS.items() for task in sorted(module.SUITE)
)


def make_batch(
    task_name: str,
    robots: int,
    *,
    nose: NoseForm = "inverse",
    motor_speed: float | None = None,
    kinematics: Kinematics | None = None,
) -> Robots:
    """Returns robots in lockstep, each alone in the arena, sensing what the task lets it.

    Args:
      task_name: "wall_avoidance" or "spot_finding".
      robots: how many.
      nose: the form of Eq. 3.
      motor_speed: speed of a wheel at motor value 0.5, in metres a second; None for the
        robot's own.
      kinematics: how the kinematic stand-in drives, to have that instead of MuJoCo.

    Raises:
      ValueError: there is no such task, or a number makes no sense.
    """
    model = arena.arena_spec(motor_speed=motor_speed).compile()
    rules = {
        "wall_avoidance": lambda: arena.wall_avoidance_rules(model),
        "spot_finding": lambda: arena.spot_finding_rules(model, nose),
    }
    if task_name not in rules:
        raise ValueError(f"task must be one of {sorted(rules)}, got {task_name!r}")
    chosen = rules[task_name]()
    if kinematics is not None:
        size = arena.Dimensions.of(model)
        return KinematicBatch(size, chosen, model.nsensordata, robots, kinematics)
    return Batch(model, chosen, robots)


def load(
    domain_name: str,
    task_name: str,
    task_kwargs: Mapping[str, Any] | None = None,
    environment_kwargs: Mapping[str, Any] | None = None,
    visualize_reward: bool = False,
) -> control.Environment:
    """Returns an environment, with the signature of `dm_control.suite.load`.

    Args:
      domain_name: "arena".
      task_name: see `ALL_TASKS`.
      task_kwargs: keywords of the task: `random`, `time_limit`, `robot`, `spot`, `nose`.
      environment_kwargs: keywords of `dm_control.rl.control.Environment`.
      visualize_reward: colours the robot by its reward.

    Raises:
      ValueError: there is no such domain or task.
    """
    if domain_name not in _DOMAINS:
        raise ValueError(f"domain must be one of {sorted(_DOMAINS)}, got {domain_name!r}")
    suite = _DOMAINS[domain_name].SUITE
    if task_name not in suite:
        raise ValueError(f"task must be one of {sorted(suite)}, got {task_name!r}")
    kwargs = dict(task_kwargs or {})
    if environment_kwargs is not None:
        kwargs["environment_kwargs"] = environment_kwargs
    environment = suite[task_name](**kwargs)
    environment.task.visualize_reward = visualize_reward
    return environment
