"""The fields of experiments and brains, and the entries of Gymnasium's `info`."""

from __future__ import annotations

import dataclasses
from typing import Any

from tables import attributes, table

from musebot.controller import BRAINS, Parameters
from musebot.models.kinematic import Kinematics
from musebot.protocols.runs.experiment import Experiment
from musebot.tasks.gymnasium_env.common import INFO, LIFE_INFO


def pages() -> dict[str, str]:
    """Returns the pages by their path below `docs/reference`."""
    return {"parameters.md": _parameters(), "experiment.md": _experiment(), "info.md": _info()}


def _shown(value: Any) -> str:
    if dataclasses.is_dataclass(value):
        return f"`{type(value).__name__}()`"
    if isinstance(value, tuple):
        return ", ".join(f"{one:g}" for one in value)
    if value is None or isinstance(value, bool):
        return str(value).lower()
    return f"{value:g}" if isinstance(value, float) else str(value)


def _parameters() -> str:
    says, steady = attributes(Parameters), BRAINS["steady"]
    rows = []
    for field in dataclasses.fields(Parameters):
        paper, ours = _shown(field.default), _shown(getattr(steady, field.name))
        ours = ours if ours == paper else f"**{ours}**"
        rows.append((f"`{field.name}`", paper, ours, field.metadata["words"], says[field.name]))
    return f"""# Parameters of a brain

All fields of `musebot.controller.Parameters`. `musebot run OUT --set brain.NAME=VALUE ..` changes
them on the command line, the section `brain` in a
[configuration file](../command.md#a-configuration-file). The brain `steady` differs from
the paper's in the bold values;
[beyond.md](../beyond.md#the-brain-steady) gives the reasons.

{table(("field", "paper", "`steady`", "allowed", "meaning"), rows)}"""


def _rows(cls: type) -> list[tuple[str, str, str]]:
    says = attributes(cls)
    return [
        (f"`{field.name}`", _shown(field.default), says[field.name])
        for field in dataclasses.fields(cls)
    ]


def _experiment() -> str:
    return f"""# Fields of an experiment

All fields of `musebot.protocols.runs.experiment.Experiment`: the section
`experiment` of a run's `experiment.json` and of a
[configuration file](../command.md#a-configuration-file). Most are
[options of `musebot run`](command.md#musebot-run).

{table(("field", "default", "meaning"), _rows(Experiment))}
`brain` has the [parameters of a brain](parameters.md). `kinematics` has the fields of
`musebot.models.kinematic.Kinematics`, for `body: kinematic` only:

{table(("field", "default", "meaning"), _rows(Kinematics))}"""


def _info() -> str:
    rows = [(f"`{name}`", meaning) for name, meaning in {**INFO, **LIFE_INFO}.items()]
    return f"""# Entries of `info`

What `reset` and `step` of Gymnasium's environments return as `info`. In a batch
(`make_vec`) each entry is an array with a row for every robot. The last {len(LIFE_INFO)} are of
[lives](../lives.md) only.

{table(("entry", "meaning"), rows)}"""
