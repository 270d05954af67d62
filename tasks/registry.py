"""Registers tasks of one's own, which open in every interface as those of the suite do."""

from __future__ import annotations

import contextlib
import math
import re
from pathlib import Path
from typing import Any, Unpack

from ..gymnasium_registration import EPISODE_STEPS, GYMNASIUM_TASKS, register_gymnasium
from ..models import check_arena
from .arena import CONTROL_TIMESTEP, SUITE, Environment, Settings, TaskDefinition, steps_until
from .batch import Batch
from .rules import Rules
from .suite import TASKS

_NAME = re.compile(r"[a-z][a-z0-9]*(_[a-z0-9]+)*")


def register_task(name: str, rules: type[Rules], **settings: Any) -> str:
    """Adds a task to the domain "arena" of this process.

    `musebot.load("arena", name)`, `musebot.tasks.make_batch(name, robots)`,
    `gymnasium.make("musebot/Name-v0")` and `gymnasium.make_vec("musebot/Name-v0", num_envs=8)` open
    it from then on. The lists `musebot.ALL_TASKS`, `PAPER` and `BENCHMARKING` stay those of the
    suite.

    Args:
      name: Name of the task, in lower case with underscores, such as "two_spots".
      rules: Observations, reward and event of the task.
      **settings: Further fields of `TaskDefinition`: `model`, the MJCF file of an arena with its
        robot; `edits` of the model, `limit` of the actions, `time_limit` and `spot_seconds` in [s].

    Returns:
      The task's Gymnasium id, such as "musebot/TwoSpots-v0".

    Raises:
      KeyError: The arena lacks a sensor.
      TypeError: A setting is unknown, or `rules` is not a class of rules.
      ValueError: The name is taken or has another form, a setting is out of range, or the arena
        lacks something.
    """
    if not _NAME.fullmatch(name):
        raise ValueError(f"name must be lower case with underscores, got {name!r}")
    if name in TASKS:
        raise ValueError(f"there is a task {name!r} already")
    if not (isinstance(rules, type) and issubclass(rules, Rules)):
        raise TypeError(f"rules must be a subclass of musebot.tasks.rules.Rules, got {rules!r}")
    if "model" in settings:  # the working directory may change
        settings["model"] = Path(settings["model"]).resolve()
    definition = TaskDefinition(name, rules, **settings)
    if not 0 < definition.limit < math.inf:
        raise ValueError(f"limit must be positive, got {definition.limit}")
    if not definition.time_limit >= CONTROL_TIMESTEP:
        raise ValueError(f"time_limit must be at least 0.1 s, got {definition.time_limit}")
    if definition.spot_seconds and not CONTROL_TIMESTEP <= definition.spot_seconds < math.inf:
        raise ValueError(
            f"spot_seconds must be 0, or at least 0.1 s, got {definition.spot_seconds}"
        )
    if abs(definition.spot_steps * CONTROL_TIMESTEP - definition.spot_seconds) > 1e-9:
        raise ValueError(f"spot_seconds must be a multiple of 0.1 s, got {definition.spot_seconds}")
    identifier = "".join(part.capitalize() for part in name.split("_")) + "-v0"
    if identifier in GYMNASIUM_TASKS:
        raise ValueError(f"the id musebot/{identifier} is that of {GYMNASIUM_TASKS[identifier]!r}")
    model = definition.spec().compile()
    check_arena(model)
    Batch(model, rules.of(model), 1)  # fails where a sensor is missing, or the timestep is another

    def factory(**keywords: Unpack[Settings]) -> Environment:
        return definition.environment(**keywords)

    factory.__name__, factory.__doc__ = name, rules.__doc__
    SUITE.add("own")(factory)
    TASKS[name] = definition
    GYMNASIUM_TASKS[identifier] = name
    steps = steps_until(definition.time_limit)
    EPISODE_STEPS[name] = int(steps) if math.isfinite(steps) else None
    with contextlib.suppress(ImportError):  # Gymnasium is optional
        register_gymnasium()
    return f"musebot/{identifier}"
