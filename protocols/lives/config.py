"""Reads an experiment and its robots from a file: TOML, or the `experiment.json` of a run."""

from __future__ import annotations

import dataclasses
import json
import tomllib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from ...controller.parameters import Parameters
from ...fields import shown
from ...models import Kinematics
from ..errors import InputError, nearest
from ..storage import read_whole
from .experiment import Experiment
from .overrides import named_brain
from .plan import changed

_MOST_BYTES = 2**20
# What a run's manifest holds; only the first two are read.
_SECTIONS = ("format", "experiment", "plan", "physics", "made_with", "digest")
_ROW = ("task", "proposer", "robots")


@dataclasses.dataclass(frozen=True)
class Config:
    """What a file asks for.

    Attributes:
      values: Fields of `Experiment` that the file gives, by name.
      robots: Number of robots for each pair of a task and a proposer (or an agent); empty if the
        file has no plan.
    """

    values: Mapping[str, Any] = dataclasses.field(default_factory=dict)
    robots: Mapping[tuple[str, str], int] = dataclasses.field(default_factory=dict)


def read_config(path: Path) -> Config:
    """Reads a file with the sections `experiment` and `plan` of a run's `experiment.json`.

    Every field may be left out. `brain` is the name of a brain, or the parameters that differ from
    the paper's brain, or from the brain that `name` names among them.

    Args:
      path: File to read: JSON if it ends in .json, otherwise TOML.

    Raises:
      InputError: there is no such file, it cannot be read, or a name or a value is invalid.
    """
    try:
        text = read_whole(path, _MOST_BYTES).decode()
        is_json = path.suffix.lower() == ".json"
        content = json.loads(text, object_pairs_hook=_once) if is_json else tomllib.loads(text)
    except FileNotFoundError as error:
        raise InputError(str(error)) from error
    except (ValueError, RecursionError) as error:
        raise InputError(f"{path} cannot be read ({' '.join(str(error).split())})") from error
    try:
        _check_names(content, _SECTIONS, "the file")
        values = _values(content.get("experiment", {}))
        changed(Experiment(), values)  # refuses what is invalid
        return Config(values, _robots(content.get("plan", [])))
    except InputError as error:
        raise InputError(f"{path}: {error}") from error


def _once(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    """Returns an object of JSON; raises ValueError for a name that is given twice."""
    found = dict(pairs)
    if len(found) < len(pairs):
        names = [name for name, _ in pairs]
        twice = next(name for name in names if names.count(name) > 1)
        raise ValueError(f"{shown(twice)} is given twice")
    return found


def _values(given: Any) -> dict[str, Any]:
    _check_names(given, _names(Experiment), "experiment")
    values = {name: _plain(value) for name, value in given.items()}
    if "brain" in values:
        brain = given["brain"]
        own = {"name": brain} if isinstance(brain, str) else brain
        _check_names(own, ("name", *_names(Parameters)), "brain")
        own = {name: _plain(value) for name, value in own.items()}
        values["brain"] = _replaced(named_brain(own.pop("name", "paper")), own)
    if "kinematics" in values:
        _check_names(given["kinematics"], _names(Kinematics), "kinematics")
        values["kinematics"] = _replaced(Kinematics(), given["kinematics"])
    return values


def _replaced(numbers: Any, values: Mapping[str, Any]) -> Any:
    try:
        return dataclasses.replace(numbers, **values)
    except ValueError as error:
        raise InputError(str(error)) from error


def _robots(rows: Any) -> dict[tuple[str, str], int]:
    if not isinstance(rows, list):
        raise InputError(f"plan must be a list of rows, got {shown(rows)}")
    robots: dict[tuple[str, str], int] = {}
    for row in rows:
        _check_names(row, _ROW, "a row of the plan")
        if missing := [name for name in _ROW if name not in row]:
            raise InputError(f"a row of the plan needs {', '.join(_ROW)}, got no {missing[0]}")
        pair = row["task"], row["proposer"]
        for name in pair:
            if not isinstance(name, str):
                raise InputError(f"task and proposer must be texts, got {shown(name)}")
        if pair in robots:
            raise InputError(f"{'/'.join(pair)} is planned twice")
        robots[pair] = row["robots"]
    return robots


def _plain(value: Any) -> Any:
    return tuple(value) if isinstance(value, list) else value


def _names(cls: Any) -> tuple[str, ...]:
    return tuple(field.name for field in dataclasses.fields(cls))


def _check_names(given: Any, allowed: tuple[str, ...], what: str) -> None:
    if not isinstance(given, Mapping):
        raise InputError(f"{what} must have names with values, got {shown(given)}")
    for name in given:
        if name not in allowed:
            raise InputError(f"{what} has no {shown(name)}; {nearest(name, allowed)}")
