"""Reads experiments of earlier versions: former names of fields, parameters and values."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from ...controller.parameters import Parameters
from ...models import Kinematics
from .experiment import Experiment

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


def experiment_from(fields: Mapping[str, Any]) -> Experiment:
    """Returns the experiment whose fields were stored as JSON, by this or an earlier version.

    Raises:
      KeyError, TypeError: the fields are not those of an experiment.
      InputError: a value is invalid.
    """
    brain: dict[str, Any] = dict(fields["brain"]) | {
        "fixed_motors": tuple(fields["brain"]["fixed_motors"])
    }
    if "random_ideas" in brain:  # formerly a number of ideas, now a share of them
        brain["random_share"] = brain.pop("random_ideas") / brain["ideas"]
    for name, neutral in _REMOVED.items():
        if brain.get(name) == neutral:
            del brain[name]
    kinematics = Kinematics(**fields.get("kinematics", {}))
    parts: dict[str, Any] = {"brain": Parameters(**_renamed(brain)), "kinematics": kinematics}
    if isinstance(settings := fields.get("settings", ()), list | tuple):
        parts["settings"] = tuple(settings)
    return Experiment(**(_renamed(fields) | parts))


def current_names(fields: Mapping[str, Any], cls: type) -> list[str]:
    """Returns the present names of stored fields, without those that no longer exist.

    Args:
      fields: Fields as stored by this or an earlier version.
      cls: `Experiment` or `Parameters`, whose fields they are.
    """
    if cls is Experiment:
        return [_RENAMED.get(name, name) for name in fields]
    gone = {name for name, neutral in _REMOVED.items() if fields.get(name) == neutral}
    names = [_RENAMED.get(name, name) for name in fields if name not in gone]
    return ["random_share" if name == "random_ideas" else name for name in names]


def _renamed(fields: Mapping[str, Any]) -> dict[str, Any]:
    return {
        _RENAMED.get(name, name): _RENAMED_VALUES.get((name, value), value)
        if isinstance(value, str)
        else value
        for name, value in fields.items()
    }
