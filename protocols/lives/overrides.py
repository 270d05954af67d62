"""Named brains, and words such as "epsilon=0.1" that override single parameters."""

from __future__ import annotations

import contextlib
import dataclasses
import json
from collections.abc import Iterable, Mapping
from types import MappingProxyType
from typing import Any, TypeVar

from ...controller.brains import BRAINS
from ...controller.parameters import Parameters
from ...models import Kinematics
from ..errors import InputError, similar

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
        raise InputError(f"the reading must be one of {', '.join(READINGS)}, got {name!r}")
    return READINGS[name]


def named_brain(name: str) -> Parameters:
    """Returns the parameters of a named brain.

    Raises:
      InputError: there is no brain of that name.
    """
    if name not in BRAINS:
        if question := similar(name, BRAINS):
            raise InputError(f"there is no brain {name!r}: {question}")
        raise InputError(f"the brain must be one of {', '.join(BRAINS)}, got {name!r}")
    return BRAINS[name]


def brain_name(brain: Parameters) -> str:
    """Returns the name of the nearest named brain, with the overrides that turn it into `brain`."""
    overrides = {name: overrides_of(brain, named) for name, named in BRAINS.items()}
    nearest = min(overrides, key=lambda name: len(overrides[name]))
    return " ".join([nearest, *overrides[nearest]])


def with_overrides(numbers: Numbers, words: Iterable[str]) -> Numbers:
    """Returns parameters of a brain or of the kinematic simulator with some of them replaced.

    Args:
      numbers: Parameters to start from.
      words: Overrides such as "epsilon=0.1" or "wall=slides"; a list is written as JSON.

    Raises:
      InputError: a name is unknown or given twice, or a value is invalid.
    """
    fields: dict[str, Any] = {}
    known = [field.name for field in dataclasses.fields(numbers)]
    for word in words:
        name, given, text = word.partition("=")
        if given and name not in known and (question := similar(name, known)):
            raise InputError(f"there is no parameter {name!r:.60}: {question}")
        if name not in known or not given:
            names = ", ".join(known)
            raise InputError(f"a parameter is set as NAME=VALUE, NAME one of {names}, got {word!r}")
        if name in fields:
            raise InputError(f"{name} is given twice")
        fields[name] = _value(text)
    try:
        return dataclasses.replace(numbers, **fields)
    except (TypeError, ValueError) as error:
        raise InputError(f"{' '.join(words)} is invalid: {error}") from error


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
