"""The file `experiment.json` of a run: plan, physics and provenance; also of older versions."""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from ...controller import Parameters
from ...models import Kinematics
from ..errors import DamagedFileError, InputError
from ..storage import read_json, write_atomically
from .conditions import Condition
from .experiment import Experiment
from .physics_probe import is_physics_of, physics_probe
from .plan import Plan
from .provenance import machine

MANIFEST = "experiment.json"

# Names that earlier versions gave to fields of an experiment and of a brain, and to their values.
_RENAMED = {
    "course": "protocol",
    "centred": "centred_inputs",
    "reward": "reward_form",
    "lingering": "reward_decay",
    "next_value": "bootstrap",
    "next_value_capped": "clipped_bootstrap",
    "action_gap": "advantage_scale",
    "error_limit": "td_error_limit",
    "memory_goal": "memory_target",
    "held_steps": "exploration_steps",
    "young_epsilon": "initial_epsilon",
    "epsilon_youth": "epsilon_decay_steps",
    "young_learn_rate": "initial_learn_rate",
    "learn_rate_youth": "learn_rate_decay_steps",
    "content_steps": "stopping_steps",
}
_RENAMED_VALUES = {
    ("course", "day"): "continual",
    ("reward", "change"): "difference",
    ("next_value", "selected"): "on_policy",
    ("next_value", "best"): "max",
    ("optimizer", "plain"): "sgd",
}
# Fields that no longer exist, and the values with which they had no effect.
_REMOVED = {"judge_rate": 1.0, "noticed_signals": False, "capped": False, "ages_with": "time"}


# What fields of JSON that are not those of an experiment raise.
UNREADABLE = (ValueError, KeyError, TypeError, AttributeError, ArithmeticError)


def write_manifest(directory: Path, plan: Plan, begun: bool = True) -> None:
    """Writes `experiment.json`: the plan, its physics, and what it is simulated with.

    `made_with` lists every set of versions and machine with which the run was begun, continued or
    enlarged.

    Args:
      directory: Folder of the run.
      plan: Plan that asks for at least what the present file asks for (`Plan.merged_with`).
      begun: Whether any life was begun with the versions of the present file.

    Raises:
      InputError: the present file is of another physics.
    """
    path = directory / MANIFEST
    made_with: list[Any] = []
    if path.exists():
        older = read_json(path)
        made_with = [one for one in older["made_with"] if begun and one != machine()]
        check_physics(directory)
    experiment = plan.experiment
    content = {
        "experiment": dataclasses.asdict(experiment),
        "plan": [{**dataclasses.asdict(c), "robots": robots} for c, robots in plan.robots.items()],
        "physics": physics_probe(experiment.body, experiment.kinematics),
        "made_with": [*made_with, machine()],
    }
    write_atomically(path, (json.dumps(content, indent=2) + "\n").encode())


def read_manifest(directory: Path) -> Plan:
    """Reads the plan of a run.

    Raises:
      FileNotFoundError: the folder holds no `experiment.json`.
      DamagedFileError: the file is damaged or foreign, or one of its values is invalid.
    """
    path = directory / MANIFEST
    content = read_json(path)
    try:
        experiment = experiment_from(content["experiment"])
        robots = {Condition(r["task"], r["proposer"]): r["robots"] for r in content["plan"]}
        if len(robots) < len(content["plan"]):
            raise ValueError("a condition is planned twice")
        if not np.isfinite(np.array(content["physics"], dtype=float)).all():
            raise ValueError("its physics is not finite")
        _ = [one["cpu"] for one in content["made_with"]]
        return Plan(experiment, robots)
    except UNREADABLE as error:
        text = f"{error!r:.200}"
        raise DamagedFileError(f"{path} is not an experiment of musebot's ({text})") from error
    except InputError as error:
        raise DamagedFileError(f"{path} is damaged ({error})") from error


def check_physics(directory: Path) -> None:
    """Raises InputError where a run was simulated in another physics than this version's."""
    if not same_physics(directory):
        raise InputError(
            f"{directory} was simulated in another physics than this version's: "
            "its robots and new ones must not be mixed"
        )


def same_physics(directory: Path) -> bool:
    """Returns whether a run that `read_manifest` reads has this version's physics."""
    content = read_json(directory / MANIFEST)
    return is_physics_of(content["physics"], experiment_from(content["experiment"]))


def experiment_from(fields: Mapping[str, Any]) -> Experiment:
    """Returns the experiment whose fields were stored as JSON, by this or an earlier version.

    Raises:
      UNREADABLE: the fields are not those of an experiment.
      InputError: a value is invalid.
    """
    brain: dict[str, Any] = dict(fields["brain"]) | {
        "fixed_motors": tuple(fields["brain"]["fixed_motors"])
    }
    if "random_ideas" in brain:  # a number of ideas before it became a share of them
        brain["random_share"] = brain.pop("random_ideas") / brain["ideas"]
    for name, neutral in _REMOVED.items():
        if brain.get(name) == neutral:
            del brain[name]
    kinematics = Kinematics(**fields.get("kinematics", {}))
    parts = {"brain": Parameters(**_renamed(brain)), "kinematics": kinematics}
    return Experiment(**(_renamed(fields) | parts))


def _renamed(fields: Mapping[str, Any]) -> dict[str, Any]:
    return {
        _RENAMED.get(name, name): _RENAMED_VALUES.get((name, value), value)
        if isinstance(value, str)
        else value
        for name, value in fields.items()
    }
