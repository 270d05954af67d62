"""Reads an experiment and its robots from a file: YAML, or the `experiment.json` of a run."""

from __future__ import annotations

import dataclasses
import json
import re
import reprlib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from ...controller.parameters import Parameters
from ...models import Kinematics
from ..errors import InputError, missing_extra
from ..storage import read_whole
from .experiment import Experiment, experiment_from
from .overrides import named_brain

_MOST_BYTES = 2**20
# What a run's manifest holds; only the first two are read.
_SECTIONS = ("format", "experiment", "plan", "physics", "made_with", "digest")
_ROW = ("task", "proposer", "robots")


@dataclasses.dataclass(frozen=True)
class Config:
    """What a file asks for.

    Attributes:
      fields: Fields of `Experiment` that the file gives, by name.
      robots: Number of robots for each pair of a task and a proposer (or an agent); empty if the
        file has no plan.
    """

    fields: Mapping[str, Any] = dataclasses.field(default_factory=dict)
    robots: Mapping[tuple[str, str], int] = dataclasses.field(default_factory=dict)


def read_config(path: Path) -> Config:
    """Reads a file with the sections `experiment` and `plan` of a run's `experiment.json`.

    Every field may be left out. `brain` is the name of a brain, or the parameters that differ from
    the paper's brain, or from the brain that `name` names among them.

    Args:
      path: File to read: JSON if it ends in .json, otherwise YAML.

    Raises:
      InputError: there is no such file, it cannot be read, or a name or a value is invalid.
    """
    content = _content(path)
    try:
        _check_names("a section", content, _SECTIONS)
        robots = _robots(_list(content.get("plan") or [], "plan"))
        return Config(_fields(_mapping(content.get("experiment") or {}, "experiment")), robots)
    except InputError as error:
        raise InputError(f"{path}: {error}") from error


def _content(path: Path) -> Mapping[str, Any]:
    try:
        text = read_whole(path, _MOST_BYTES).decode()
        found = json.loads(text) if path.suffix.lower() == ".json" else _yaml(text)
    except FileNotFoundError as error:
        raise InputError(str(error)) from error
    except (ValueError, RecursionError) as error:
        raise InputError(f"{path} cannot be read ({' '.join(str(error).split())})") from error
    if not isinstance(found, Mapping):
        raise InputError(f"{path} must have the sections experiment and plan")
    return found


def _yaml(text: str) -> Any:
    """Reads YAML; 1e-3 is a number as in YAML 1.2, and a key that is given twice is refused."""
    try:
        import yaml
    except ModuleNotFoundError as error:
        raise InputError(missing_extra(error)) from error

    class Loader(yaml.SafeLoader):
        def construct_mapping(self, node: Any, deep: bool = False) -> dict[Any, Any]:
            keys = [
                self.construct_object(key, deep=True)
                for key, _ in node.value
                if key.tag != "tag:yaml.org,2002:merge"
            ]
            for key in keys:
                if keys.count(key) > 1:
                    raise ValueError(f"{key} is given twice")
            return super().construct_mapping(node, deep)

    number = re.compile(r"[-+]?(\d+\.?\d*|\.\d+)[eE][-+]?\d+")
    Loader.add_implicit_resolver("tag:yaml.org,2002:float", number, [*"-+.0123456789"])
    try:
        return yaml.load(text, Loader)  # a SafeLoader: it makes plain data only
    except (yaml.YAMLError, TypeError, LookupError, AttributeError) as error:
        raise ValueError(str(error)) from error


def _fields(given: Mapping[str, Any]) -> dict[str, Any]:
    names = [*given]
    _check_names("a field of the experiment", names, _names(Experiment))
    brain = given.get("brain", {})
    if isinstance(brain, str):
        brain = {"name": brain}
    brain = dict(_mapping(brain, "brain"))
    if not isinstance(name := brain.pop("name", "paper"), str):
        raise InputError(f"the brain's name must be a text, got {_short(name)}")
    base = named_brain(name)
    _check_names("a parameter of the brain", brain, _names(Parameters))
    kinematics = _mapping(given.get("kinematics", {}), "kinematics")
    _check_names("a parameter of kinematics", kinematics, _names(Kinematics))
    whole = dataclasses.asdict(Experiment()) | dict(given)
    whole |= {"brain": dataclasses.asdict(base) | brain}
    whole |= {"kinematics": dataclasses.asdict(Kinematics()) | dict(kinematics)}
    try:
        experiment = experiment_from(whole)
    except (ValueError, TypeError, ArithmeticError) as error:
        raise InputError(str(error)) from error
    return {name: getattr(experiment, name) for name in names}


def _robots(rows: list[Any]) -> dict[tuple[str, str], int]:
    robots: dict[tuple[str, str], int] = {}
    for row in rows:
        _check_names("a row of the plan", _mapping(row, "a row of the plan"), _ROW)
        if missing := [name for name in _ROW if name not in row]:
            raise InputError(f"a row of the plan needs {', '.join(_ROW)}, got no {missing[0]}")
        task, proposer = row["task"], row["proposer"]
        if not (isinstance(task, str) and isinstance(proposer, str)):
            raise InputError(
                f"task and proposer must be texts, got {_short(task)} and {_short(proposer)}"
            )
        pair = task, proposer
        if pair in robots:
            raise InputError(f"{'/'.join(pair)} is planned twice")
        if type(number := row["robots"]) is not int or number < 1:
            raise InputError(f"robots must be at least 1, got {_short(number)}")
        robots[pair] = number
    return robots


def _short(value: Any) -> str:
    """Returns a value as text; parts that YAML repeats by reference are not written out."""
    return reprlib.repr(value)[:60]


def _names(cls: Any) -> tuple[str, ...]:
    return tuple(field.name for field in dataclasses.fields(cls))


def _check_names(what: str, given: Any, allowed: tuple[str, ...]) -> None:
    for name in given:
        if name not in allowed:
            raise InputError(f"{what} must be one of {', '.join(allowed)}, got {name!r}")


def _mapping(value: Any, what: str) -> Mapping[str, Any]:
    if not isinstance(value, Mapping):
        raise InputError(f"{what} must be names with values, got {_short(value)}")
    return value


def _list(value: Any, what: str) -> list[Any]:
    if not isinstance(value, list):
        raise InputError(f"{what} must be a list of rows, got {_short(value)}")
    return value
