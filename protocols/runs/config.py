"""Reads experiments from names of brains and readings, words NAME=VALUE, and files.

A file is TOML, or the `experiment.json` of a run.
"""

from __future__ import annotations

import contextlib
import dataclasses
import json
import tomllib
from collections.abc import Iterable, Mapping
from pathlib import Path
from types import MappingProxyType
from typing import Any, TypeVar

from ...controller.parameters import Parameters
from ...controller.presets import BRAINS
from ...fields import shown
from ...models import Dimensions, Kinematics
from ...tasks.lives import LIVES, Life, life_from
from ...tasks.suite import TASKS, task_definition
from ..agents.names import recorded_name
from ..errors import InputError, check_name, nearest
from ..storage import parsed, read_whole
from .conditions import Condition
from .experiment import Experiment
from .manifest import VALUES
from .plan import check_robots

Numbers = TypeVar("Numbers", Parameters, Kinematics)

# Readings (interpretations) of the paper, as fields of an experiment. "body": the brain in a
# physical body. "plain": the simplest program that fits the paper's text (docs/paper.md).
READINGS: Mapping[str, Mapping[str, Any]] = MappingProxyType(
    {
        "body": MappingProxyType(
            {"body": "mujoco", "kinematics": Kinematics(), "nose": "inverse", "nose_place": "front"}
        ),
        "plain": MappingProxyType(
            {
                "body": "kinematic",
                "kinematics": Kinematics(wall="refuses", felt="pushed", pieces=1, path="euler"),
                "nose": "inverse",
                "nose_place": "centre",
            }
        ),
    }
)

_ROW = ("task", "proposer", "robots")


# ---- Names ----


def named_reading(name: str) -> Mapping[str, Any]:
    """Returns the fields that a reading of the paper sets; InputError for an unknown name."""
    check_name("reading", name, READINGS)
    return READINGS[name]


def named_brain(name: str) -> Parameters:
    """Returns the parameters of a named brain; raises InputError for an unknown name."""
    check_name("brain", name, BRAINS)
    return BRAINS[name]


# ---- Words NAME=VALUE ----


def values_of(words: Iterable[str], known: Iterable[str]) -> dict[str, Any]:
    """Reads words NAME=VALUE; returns the values by name.

    Args:
      words: Words NAME=VALUE. A number or JSON (true, [1,2]) as VALUE is decoded; all else
        is text.
      known: Names that may stand before "=".

    Raises:
      InputError: a word has another form, or a name is unknown or given twice.
    """
    names = [*known]
    values: dict[str, Any] = {}
    for word in words:
        name, given, value = word.partition("=")
        if not given:
            raise InputError(f"a value is set as NAME=VALUE, got {shown(word)}")
        check_name("parameter", name, names)
        if name in values:
            raise InputError(f"{name} is given twice")
        values[name] = _value(value)
    return values


def _value(text: str) -> Any:
    for read in (json.loads, float):
        with contextlib.suppress(ValueError, RecursionError):
            return _plain(read(text))
    return text


def _plain(value: Any) -> Any:
    return tuple(value) if isinstance(value, list) else value


def _replaced(numbers: Numbers, values: Mapping[str, Any]) -> Numbers:
    try:
        return dataclasses.replace(numbers, **values)
    except ValueError as error:
        raise InputError(str(error)) from error


# ---- Files ----


@dataclasses.dataclass(frozen=True)
class Config:
    """Contents of a configuration file.

    Attributes:
      values: Fields of `Experiment` that the file gives, by name.
      robots: Number of robots of each condition; empty if the file has no plan.
    """

    values: Mapping[str, Any] = dataclasses.field(default_factory=dict)
    robots: Mapping[Condition, int] = dataclasses.field(default_factory=dict)


def read_config(path: Path) -> Config:
    """Reads a file with the sections `experiment` and `plan` of a run's `experiment.json`.

    Every field may be left out. `brain` is the name of a brain, or a table of parameters that
    replace those of the paper's brain or, if the table has a `name`, of the brain of this name. The
    other fields are checked later, by `experiment.changed`: the command may override them.

    Args:
      path: File to read: JSON if it ends in .json, otherwise TOML.

    Raises:
      InputError: there is no such file, it cannot be read, or a name or a value is invalid.
    """
    try:
        text = read_whole(path)
        is_json = path.suffix.lower() == ".json"
        content = parsed(path, text) if is_json else _toml(text)
    except OSError as error:
        raise InputError(str(error)) from error
    except (ValueError, RecursionError) as error:
        raise InputError(f"{path} cannot be read ({' '.join(str(error).split())})") from error
    try:
        content = _checked(content, VALUES, "the file")
        values = _values(content.get("experiment", {}))
        return Config(values, _robots(content.get("plan", ())))
    except InputError as error:
        raise InputError(f"{path}: {error}") from error


def read_life(path: Path) -> Life:
    """Returns the life of a TOML file (docs/lives.md).

    Raises:
      InputError: there is no such file, it cannot be read, its life has the name of one of
        musebot's lives or tasks, or a value is not allowed.
    """
    try:
        return _own_life(_toml(read_whole(path)))
    except OSError as error:
        raise InputError(str(error)) from error
    except (InputError, ValueError, RecursionError) as error:
        raise InputError(f"{path}: {' '.join(str(error).split())}") from error


def _toml(text: bytes) -> dict[str, Any]:
    return tomllib.loads(text.decode("utf-8-sig"))  # some editors write a mark of UTF-8


def _own_life(fields: Any) -> Life:
    """Returns the life that has these fields; raises InputError if a field is invalid."""
    try:
        life = life_from(fields)
        if life.name in LIVES or life.name in TASKS:
            raise ValueError(f"there is a life or task {life.name} already")
        model = task_definition(life.task).spec().compile()
        life.check(task_definition(life.task).rules.of(model), Dimensions.of(model))
    except (ValueError, TypeError, RecursionError) as error:
        raise InputError(" ".join(str(error).split())) from error
    return life


def _values(given: Any) -> dict[str, Any]:
    values = _checked(given, _names(Experiment), "experiment")
    if "brain" in values:
        brain = values["brain"]
        own = {"name": brain} if isinstance(brain, str) else brain
        own = _checked(own, ("name", *_names(Parameters)), "brain")
        values["brain"] = _replaced(named_brain(str(own.pop("name", "paper"))), own)
    if "kinematics" in values:
        own = _checked(values["kinematics"], _names(Kinematics), "kinematics")
        values["kinematics"] = _replaced(Kinematics(), own)
    if values.get("life") is not None:
        values["life"] = _own_life(values["life"])
    return values


def _robots(rows: Any) -> dict[Condition, int]:
    if not isinstance(rows, tuple):
        raise InputError(f"plan must be a list of rows, got {shown(rows)}")
    robots: dict[Condition, int] = {}
    for row in rows:
        own = _checked(row, _ROW, "a row of the plan")
        if missing := [name for name in _ROW if name not in own]:
            raise InputError(f"a row of the plan needs {', '.join(_ROW)}, got no {missing[0]}")
        names = own["task"], own["proposer"]
        if not all(isinstance(name, str) for name in names):
            raise InputError(f"task and proposer must be texts, got {shown(names)}")
        # An agent may have several names.
        condition = Condition(own["task"], recorded_name(own["proposer"]))
        if condition in robots:
            raise InputError(f"{condition} is planned twice")
        check_robots(own["robots"])
        robots[condition] = own["robots"]
    return robots


def _checked(given: Any, allowed: tuple[str, ...], what: str) -> dict[str, Any]:
    """Returns values by name, lists as tuples; raises InputError for a name not in `allowed`."""
    if not isinstance(given, Mapping):
        raise InputError(f"{what} must have names with values, got {shown(given)}")
    for name in given:
        if name not in allowed:
            raise InputError(f"{what} has no {shown(name)}; {nearest(name, allowed)}")
    return {name: _plain(value) for name, value in given.items()}


def _names(numbers: Any) -> tuple[str, ...]:
    return tuple(field.name for field in dataclasses.fields(numbers))
