"""Musebot: Mayer's creative robot (IEEE SMC 2004), alive in MuJoCo.

The tasks open like any of dm_control's; importing this module alone loads no physics, no torch and
no OpenGL, but tells Gymnasium, where it is installed, the names of the tasks.

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

# Gymnasium's names, in its namespace "musebot". A version changes with what the task means.
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
      domain_name: first half of an entry of `ALL_TASKS`.
      task_name: second half of the same entry.
      task_kwargs: keywords of the task.
      environment_kwargs: keywords of `dm_control.rl.control.Environment`.
      visualize_reward: whether the robot's colour shows its reward.

    Raises:
      TypeError: a keyword is unknown.
      ValueError: there is no such domain or task, or a value makes no sense.
    """
    from . import tasks

    return tasks.load(domain_name, task_name, task_kwargs, environment_kwargs, visualize_reward)


def register() -> None:
    """Lets `dm_control.suite.load("musebot_arena", TASK)` find the tasks, in this process."""
    from . import tasks

    tasks.register()


def register_gymnasium() -> None:
    """Lets `gymnasium.make("musebot/WallAvoidance-v0")` find the tasks.

    Importing musebot does so too: since its version 1.0 Gymnasium has no plugins, and learns of
    environments when somebody imports them. Nothing but the names is loaded.

    Raises:
      ModuleNotFoundError: Gymnasium is not installed.
    """
    promptless = "PYGAME_HIDE_SUPPORT_PROMPT" in os.environ
    import gymnasium

    if not promptless:  # Gymnasium sets it, and importing musebot sets nothing
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


with contextlib.suppress(ImportError):  # Gymnasium is an extra
    register_gymnasium()
