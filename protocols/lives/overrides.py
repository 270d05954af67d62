"""Named brains and readings of the paper, and words NAME=VALUE that change single values."""

from __future__ import annotations

import contextlib
import dataclasses
import json
from collections.abc import Iterable, Mapping
from types import MappingProxyType
from typing import Any, TypeVar

from ...controller.brains import BRAINS
from ...controller.parameters import Parameters
from ...fields import shown
from ...models import Kinematics
from ..errors import InputError, nearest, similar

Numbers = TypeVar("Numbers", Parameters, Kinematics)

# Readings of the paper: fields of an experiment. "body": the brain in a physical body. "plain": the
# plainest program that the paper's text describes (docs/paper.md).
READINGS: Mapping[str, Mapping[str, Any]] = MappingProxyType(
    {
        "body": MappingProxyType(
            {
                "body": "mujoco",
                "kinematics": Kinematics(),
                "nose": "inverse",
                "nose_place": "front",
            }
        ),
        "plain": MappingProxyType(
            {
                "body": "kinematic",
                "kinematics": Kinematics(wall="refuses", felt="pushed", pieces=1, path="euler"),
                "nose": "printed",
                "nose_place": "centre",
            }
        ),
    }
)


def named_reading(name: str) -> Mapping[str, Any]:
    """Returns the fields of an experiment that a reading of the paper sets.

    Raises:
      InputError: there is no reading of that name.
    """
    if name not in READINGS:
        raise InputError(f"the reading must be one of {', '.join(READINGS)}, got {shown(name)}")
    return READINGS[name]


def named_brain(name: str) -> Parameters:
    """Returns the parameters of a named brain.

    Raises:
      InputError: there is no brain of that name.
    """
    if name not in BRAINS:
        if question := similar(name, BRAINS):
            raise InputError(f"there is no brain {shown(name)}: {question}")
        raise InputError(f"the brain must be one of {', '.join(BRAINS)}, got {shown(name)}")
    return BRAINS[name]


def brain_name(brain: Parameters) -> str:
    """Returns the name of the nearest named brain, with the overrides that turn it into `brain`."""
    overrides = {name: overrides_of(brain, named) for name, named in BRAINS.items()}
    closest = min(overrides, key=lambda name: len(overrides[name]))
    return " ".join([closest, *overrides[closest]])


def with_overrides(numbers: Numbers, words: Iterable[str]) -> Numbers:
    """Returns parameters of a brain or of the kinematic simulator with some of them replaced.

    Args:
      numbers: Parameters to start from.
      words: Overrides such as "epsilon=0.1" or "wall=slides"; a list is written as JSON.

    Raises:
      InputError: a name is unknown or given twice, or a value is invalid.
    """
    values = values_of(words, [field.name for field in dataclasses.fields(numbers)])
    try:
        return dataclasses.replace(numbers, **values)
    except ValueError as error:
        raise InputError(str(error)) from error


def values_of(words: Iterable[str], known: Iterable[str]) -> dict[str, Any]:
    """Reads words NAME=VALUE.

    Args:
      words: Words; a value is a number, true, false, null, a list as JSON, or else a text.
      known: Names that are allowed.

    Raises:
      InputError: a word has another form, or a name is unknown or given twice.
    """
    names = [*known]
    values: dict[str, Any] = {}
    for word in words:
        name, given, value = word.partition("=")
        if not given:
            raise InputError(f"a value is set as NAME=VALUE, got {shown(word)}")
        if name not in names:
            raise InputError(f"there is no parameter {shown(name)}; {nearest(name, names)}")
        if name in values:
            raise InputError(f"{name} is given twice")
        values[name] = _value(value)
    return values


def overrides_of(numbers: Numbers, reference: Numbers) -> list[str]:
    """Returns the overrides that turn a reference into the given parameters."""
    theirs = dataclasses.asdict(reference)
    return [
        f"{name}={value if isinstance(value, str) else json.dumps(value, separators=(',', ':'))}"
        for name, value in dataclasses.asdict(numbers).items()
        if value != theirs[name]
    ]


def _value(text: str) -> Any:
    for read in (json.loads, float):
        with contextlib.suppress(ValueError, RecursionError):
            value = read(text)
            return tuple(value) if isinstance(value, list) else value
    return text
