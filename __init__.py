"""Musebot: Mayer's creative robot (IEEE SMC 2004) in MuJoCo.

The tasks load like those of dm_control. Importing this module loads no physics, no torch and no
OpenGL; it registers the tasks with Gymnasium if that is installed.

    import musebot

    env = musebot.load("arena", "wall_avoidance", task_kwargs={"random": 1})
"""

from __future__ import annotations

import contextlib
import os
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from collections.abc import Mapping

    from dm_control.rl import control

    from .tasks import ALL_TASKS, BENCHMARKING, PAPER, SUITE, TASKS_BY_DOMAIN

__version__ = "0.1.0"

__all__ = [
    "ALL_TASKS",
    "BENCHMARKING",
    "GYMNASIUM_TASKS",
    "PAPER",
    "SUITE",
    "TASKS_BY_DOMAIN",
    "load",
    "register",
    "register_gymnasium",
]

# Gymnasium ids in the namespace "musebot", and their tasks. A task that changes gets a new version.
GYMNASIUM_TASKS = {
    "WallAvoidance-v0": "wall_avoidance",
    "SpotFinding-v0": "spot_finding",
    "WallAvoidanceUnit-v0": "wall_avoidance_unit",
    "WallAvoidanceObstacles-v0": "wall_avoidance_obstacles",
    "SpotFindingUnit-v0": "spot_finding_unit",
    "SpotFindingTwoNoses-v0": "spot_finding_two_noses",
    "SpotFindingWalls-v0": "spot_finding_walls",
    "SpotFindingJumping-v0": "spot_finding_jumping",
}


def load(
    domain_name: str,
    task_name: str,
    task_kwargs: Mapping[str, Any] | None = None,
    environment_kwargs: Mapping[str, Any] | None = None,
    visualize_reward: bool = False,
) -> control.Environment:
    """Returns an environment, with the signature of `dm_control.suite.load`.

    Args:
      domain_name: Name of the domain, the first half of an entry of `ALL_TASKS`.
      task_name: Name of the task, the second half of that entry.
      task_kwargs: Keywords of the task, see docs/tasks.md.
      environment_kwargs: Keywords of `dm_control.rl.control.Environment`.
      visualize_reward: Whether the robot's colour shows its reward.

    Raises:
      TypeError: A keyword is unknown.
      ValueError: There is no such domain or task, or a value is out of range.
    """
    from . import tasks

    return tasks.load(domain_name, task_name, task_kwargs, environment_kwargs, visualize_reward)


def register() -> None:
    """Registers the tasks for `dm_control.suite.load("musebot_arena", TASK)` in this process."""
    from . import tasks

    tasks.register()


def register_gymnasium() -> None:
    """Registers the tasks for `gymnasium.make("musebot/WallAvoidance-v0")`.

    Importing musebot calls this: Gymnasium 1.x has no plugins, so that a package registers its
    environments when it is imported. Only the names are registered; no environment is loaded.

    Raises:
      ModuleNotFoundError: Gymnasium is not installed.
    """
    promptless = "PYGAME_HIDE_SUPPORT_PROMPT" in os.environ
    import gymnasium

    if not promptless:  # Gymnasium sets it; importing musebot must not change the environment
        os.environ.pop("PYGAME_HIDE_SUPPORT_PROMPT", None)
    for name, task in GYMNASIUM_TASKS.items():
        if f"musebot/{name}" in gymnasium.registry:
            continue
        gymnasium.register(
            id=f"musebot/{name}",
            entry_point="musebot.tasks.gymnasium_env:ArenaEnv",
            vector_entry_point="musebot.tasks.gymnasium_env:ArenaVectorEnv",
            kwargs={"task": task},
            max_episode_steps=1000,
        )


def __getattr__(name: str) -> Any:
    if name in ("ALL_TASKS", "BENCHMARKING", "PAPER", "SUITE", "TASKS_BY_DOMAIN"):
        from . import tasks

        return getattr(tasks, name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


with contextlib.suppress(ImportError):  # Gymnasium is optional
    register_gymnasium()
