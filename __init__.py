"""Musebot: Mayer's creative robot (IEEE SMC 2004), alive in MuJoCo.

The tasks open like any of dm_control's; importing this module alone loads no physics, no torch and
no OpenGL.

    import musebot

    env = musebot.load("arena", "wall_avoidance", task_kwargs={"random": 1})
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from collections.abc import Mapping

    from dm_control.rl import control

    from .tasks import ALL_TASKS

__version__ = "0.1.0"

__all__ = ["ALL_TASKS", "load"]


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
      ValueError: there is no such domain or task.
    """
    from . import tasks

    return tasks.load(domain_name, task_name, task_kwargs, environment_kwargs, visualize_reward)


def __getattr__(name: str) -> Any:
    if name == "ALL_TASKS":
        from .tasks import ALL_TASKS

        return ALL_TASKS
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
