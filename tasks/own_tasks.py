"""Registers users' own tasks, which every interface then opens like those of the suite."""

from __future__ import annotations

import contextlib
import math
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from ..gymnasium_registration import EPISODE_STEPS, GYMNASIUM_TASKS, MODULES, register_gymnasium
from ..models import check_arena
from .arena import TaskDefinition, steps_until
from .batch import Batch
from .episode import check_keywords
from .lives import LIVES
from .rules import Rules, within
from .starts import random_poses
from .suite import LIFE_DOMAIN, TASKS, add_task

_NAME = re.compile(r"[a-z][a-z0-9]*(_[a-z0-9]+)*")
_TAKEN = {*TASKS, *LIVES, LIFE_DOMAIN}  # when this is imported, all tasks are musebot's
_SETTINGS = ("model", "edits", "limit", "time_limit", "spot_seconds")
_PROBED = 60  # control steps: straight ahead, across the arena and into a wall


def register_task(name: str, rules: type[Rules], **settings: Any) -> str:
    """Adds a task to the domain "arena" of this process, see `musebot.register_task`."""
    if not (isinstance(name, str) and _NAME.fullmatch(name)):
        raise ValueError(f"name must be lower case with underscores, got {name!r:.60}")
    if name in _TAKEN:
        raise ValueError(f"there is a task or life {name!r} in musebot already")
    if not (isinstance(rules, type) and issubclass(rules, Rules)):
        raise TypeError(f"rules must be a subclass of musebot.tasks.rules.Rules, got {rules!r}")
    check_keywords("register_task", settings, _SETTINGS)
    if "model" in settings:
        settings["model"] = _file(settings["model"])
    definition = TaskDefinition(name, rules, **settings)
    identifier = "".join(part.capitalize() for part in name.split("_")) + "-v0"
    if GYMNASIUM_TASKS.get(identifier, name) != name:
        raise ValueError(f"the id musebot/{identifier} is that of {GYMNASIUM_TASKS[identifier]!r}")
    model = definition.spec().compile()
    check_arena(model)
    # Fails where a sensor is missing, or the timestep does not divide 0.1 s.
    _check_rules(Batch(model, rules.of(model, "inverse"), 2))
    add_task(definition, "own")
    GYMNASIUM_TASKS[identifier] = name
    MODULES.pop(name, None)
    module = rules.__module__
    if module != "__main__" and not module.startswith(f"{__package__}."):
        MODULES[name] = module  # modules excluded above do not register the task
    steps = steps_until(definition.time_limit)
    EPISODE_STEPS[name] = int(steps) if math.isfinite(steps) else None
    with contextlib.suppress(ImportError):  # Gymnasium is optional
        import gymnasium

        gymnasium.registry.pop(f"musebot/{identifier}", None)  # of a task that is replaced
        register_gymnasium()
    return f"musebot/{identifier}"


def _file(model: Any) -> Path:
    """Returns the absolute path of a model's file: the working directory may change."""
    try:
        path = Path(model).resolve()
    except (TypeError, ValueError, OSError):  # OSError: the working directory was deleted
        path = None
    if path is None or not path.is_file():
        raise ValueError(f"model must be an MJCF file, got {str(model)!r:.200}")
    return path


def _check_rules(batch: Batch) -> None:
    """Raises ValueError unless rules return what they declare, for one robot and for several.

    Two robots drive from the spot into a wall.
    """
    rules, everyone = batch.rules, np.arange(batch.robots)
    try:
        declared = {**rules.shapes, "the reward": (1, *rules.rewards)}.values()
        sound = bool(rules.shapes) and all(
            isinstance(length, int | np.integer) and length >= 1 and low <= high
            for length, low, high in declared
        )
    except (AttributeError, TypeError, ValueError):
        sound = False
    if not sound:
        raise ValueError(
            f"{type(rules).__name__} must declare shapes, (length, minimum, maximum) by name, and "
            "rewards, (minimum, maximum)"
        )
    poses = random_poses(np.random.default_rng(0), batch.dimensions, batch.robots)
    batch.place_spot(everyone, poses[:, :2])
    batch.place(everyone, poses)
    for _ in range(_PROBED):
        for measured in (batch.sensordata, batch.sensordata[0]):
            _check_values(rules, measured)
        batch.step(np.full((batch.robots, 2), 0.5))


def _check_values(rules: Rules, measured: np.ndarray) -> None:
    shape = measured.shape[:-1]
    observations = rules.observations(measured)
    if not isinstance(observations, Mapping):
        raise ValueError(f"observations must be a dict, got {observations!r:.100}")
    declared = {name: (*shape, length) for name, (length, _, _) in rules.shapes.items()}
    seen = {name: np.shape(one) for name, one in observations.items()}
    if [*seen.items()] != [*declared.items()]:
        raise ValueError(f"observations must have the shapes {declared}, got {seen}")
    for name, values in observations.items():
        _, low, high = rules.shapes[name]
        if not within(np.asarray(values), declared[name], (low, high)):
            raise ValueError(
                f"{name} must be numbers from {low:g} to {high:g}, got {values!r:.100}"
            )
    rules.checked_reward(measured)
    if (found := np.shape(rules.event(measured))) != shape:
        raise ValueError(f"event must have the shape {shape}, got {found}")
