"""Musebot: Mayer's creative robot (IEEE SMC 2004) in MuJoCo.

Tasks are loaded as in dm_control. Importing this module loads neither MuJoCo nor torch nor OpenGL;
it registers the tasks with Gymnasium if that is installed.

    import musebot

    env = musebot.load("arena", "wall_avoidance", task_kwargs={"random": 1})
"""

from __future__ import annotations

import contextlib
import importlib
import pathlib
from typing import TYPE_CHECKING, Any

from .extras import extra_needed
from .gymnasium_registration import GYMNASIUM_TASKS, register_gymnasium

if TYPE_CHECKING:
    from collections.abc import Mapping
    from pathlib import Path

    from .protocols.runs.run import Run
    from .tasks import ALL_TASKS, BENCHMARKING, PAPER, SUITE, TASKS_BY_DOMAIN
    from .tasks.arena import Environment
    from .tasks.rules import Rules

__version__ = "1.0.0"

__all__ = [
    "ALL_TASKS",
    "BENCHMARKING",
    "GYMNASIUM_TASKS",
    "PAPER",
    "SUITE",
    "TASKS_BY_DOMAIN",
    "load",
    "load_run",
    "register",
    "register_gymnasium",
    "register_task",
    "run",
]


def load(
    domain_name: str,
    task_name: str,
    task_kwargs: Mapping[str, Any] | None = None,
    environment_kwargs: Mapping[str, Any] | None = None,
    visualize_reward: bool = False,
) -> Environment:
    """Returns a task's dm_control environment; called like `dm_control.suite.load`.

    Args:
      domain_name: "arena" for the tasks in `ALL_TASKS`; "life" for lives, each one episode.
      task_name: Name of a task in `ALL_TASKS`; in the domain "life", name of a life, such as
        "drift", or a TOML file (docs/lives.md).
      task_kwargs: Keyword arguments of the task, such as {"random": 1}; see docs/tasks.md.
      environment_kwargs: Dictionary with two optional keys: `flat_observation` (whether all signals
        are joined in one array) and `time_limit` (length of an episode in [s]).
      visualize_reward: Whether the robot's colour shows its reward.

    Raises:
      TypeError: A keyword is unknown.
      ValueError: There is no such domain or task, or a value is out of range.
    """
    from . import tasks

    return tasks.load(domain_name, task_name, task_kwargs, environment_kwargs, visualize_reward)


def run(out: str | Path, *, quiet: bool = False, **options: Any) -> Run:
    """Starts or continues a run, as the command `musebot run` does.

    Args:
      out: Folder of the run: a new folder, or the folder of a run to continue.
      quiet: Whether to hide the progress display.
      **options: Options of `musebot run`, with underscores, such as `life`, `robots` and `brain`;
        see `protocols.cli.run.run`.

    Returns:
      The run with all robots in its folder, those of earlier calls included.

    Raises:
      TypeError: An option is unknown.
      ModuleNotFoundError: The extra `brain`, or one that an option needs, is not installed.
      protocols.errors.InputError: A value is invalid, or the folder holds another experiment or
        files other than a run's.
    """
    with extra_needed():
        return _protocol("cli.run").run(out, quiet=quiet, **options)


def load_run(out: str | Path, networks: bool = True) -> Run:
    """Reads the finished robots of a run; simulates nothing, and changes nothing on disk.

    Args:
      out: Folder of a run with at least one finished robot.
      networks: Whether to read the robots' networks; must be False for a run kept without them.

    Raises:
      ModuleNotFoundError: The extra `brain` is not installed.
      protocols.errors.InputError: The folder holds no run, no finished robot, damaged files, or,
        although `networks` is True, no networks.
    """
    with extra_needed():
        return _protocol("runs.run_files").read_run(pathlib.Path(out), networks=networks)


def _protocol(module: str) -> Any:
    """Imports a module of `protocols` late: those modules import `__version__` from this one."""
    return importlib.import_module(f"{__name__}.protocols.{module}")


def register_task(name: str, rules: type[Rules], **settings: Any) -> str:
    """Registers a task of your own in every interface of this process.

    `musebot.ALL_TASKS` and the other lists keep only the suite's tasks. If you register a task
    of your own again, for example after a reload, it replaces the former one.

    Args:
      name: Name of the task, in lower case with underscores, such as "my_task".
      rules: Subclass of `tasks.rules.Rules` with the task's observations, reward and event.
      **settings: Further fields of `tasks.arena.TaskDefinition`: `model`, the MJCF file of an arena
        with its robot; `edits` of the model, `limit` of the actions, `time_limit` and
        `spot_seconds` in [s].

    Returns:
      The task's Gymnasium id, such as "musebot/MyTask-v0".

    Raises:
      KeyError: The arena lacks a sensor.
      TypeError: A setting is unknown, or `rules` is not a subclass of `Rules`.
      ValueError: The name is taken or not like "my_task", a setting is out of range,
        `models.check_arena` refuses the arena, or the rules do not return what they declare.
    """
    from .tasks import own_tasks

    return own_tasks.register_task(name, rules, **settings)


def register() -> None:
    """Registers the tasks for `dm_control.suite.load("musebot_arena", TASK)` in this process."""
    from . import tasks

    tasks.register()


def __getattr__(name: str) -> Any:
    if name in ("ALL_TASKS", "BENCHMARKING", "PAPER", "SUITE", "TASKS_BY_DOMAIN"):
        from . import tasks

        return getattr(tasks, name)
    if name in ("controller", "models", "protocols", "tasks"):
        return importlib.import_module(f"{__name__}.{name}")
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


with contextlib.suppress(ImportError):  # Gymnasium is optional
    register_gymnasium()
