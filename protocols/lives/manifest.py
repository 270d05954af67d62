"""The file `experiment.json`: plan, physics, provenance, digests of a run's other files."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from ...models import Kinematics
from ..errors import DamagedFileError, InputError
from ..storage import read_json, write_json
from .conditions import Condition
from .experiment import Experiment, experiment_from
from .overrides import brain_name, overrides_of
from .physics_probe import is_physics_of, physics_probe
from .plan import Plan
from .provenance import machine

MANIFEST = "experiment.json"
_FILES = "files"

# Exceptions of reading JSON whose fields are not those of an experiment.
UNREADABLE = (ValueError, KeyError, TypeError, AttributeError, ArithmeticError)


def write_manifest(directory: Path, plan: Plan, begun: bool = True) -> None:
    """Writes `experiment.json`: the plan, its physics, and the versions that simulate it.

    `made_with` lists every combination of versions and machine with which the run was begun,
    continued or enlarged.

    Args:
      directory: Folder of the run; `check_physics` accepts it.
      plan: Plan with at least the robots in the plan of the existing file (see `Plan.merged_with`).
      begun: Whether to keep the list of versions in the existing file; False if no robot was
        simulated with those versions.
    """
    path = directory / MANIFEST
    made_with: list[Any] = []
    files: dict[str, Any] = {}
    if path.exists():
        older = read_json(path)
        files = {_FILES: older[_FILES]} if _FILES in older else {}
        made_with = [one for one in older["made_with"] if begun and one != machine()]
    experiment = plan.experiment
    robots = sorted(plan.robots.items())  # a run that was continued has them in this order
    content = {
        "experiment": dataclasses.asdict(experiment),
        "plan": [{**dataclasses.asdict(condition), "robots": n} for condition, n in robots],
        "physics": physics_probe(experiment.body, experiment.kinematics),
        "made_with": [*made_with, machine()],
    }
    write_json(path, content | files)


def record_files(directory: Path, digests: Mapping[str, str]) -> None:
    """Adds the digests of files that are about to be written to those of earlier ones.

    A run that is enlarged writes its files one after the other, and may be killed, or read,
    between two of them: the digests of all earlier states stay.

    Args:
      directory: Folder of a run.
      digests: SHA-256 digest of each file's content, by the name of the file.

    Raises:
      OSError: `experiment.json` cannot be written.
    """
    path = directory / MANIFEST
    content = read_json(path)
    earlier = [state for state in content.get(_FILES, []) if state != digests]
    write_json(path, content | {_FILES: [*earlier, dict(digests)]})


def recorded_files(directory: Path) -> list[dict[str, str]]:
    """Returns the digests of a run's files, by name, of each state; empty for an older run's.

    Raises:
      DamagedFileError: they are no digests.
    """
    path = directory / MANIFEST
    try:
        return [dict(state) for state in read_json(path).get(_FILES, [])]
    except UNREADABLE as error:
        raise DamagedFileError(f"{path} is damaged (its digests are none)") from error


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
    """Raises InputError if a run was simulated in another physics than this version's."""
    if not same_physics(directory):
        raise InputError(
            f"{directory} was simulated in another physics than this version's: "
            "its robots and new ones must not be mixed"
        )


def same_physics(directory: Path) -> bool:
    """Returns whether a run that `read_manifest` reads has this version's physics."""
    content = read_json(directory / MANIFEST)
    experiment = experiment_from(content["experiment"])
    if experiment.physics == "warp":  # in single precision each version rounds in its own way
        ours = machine()
        for one in content["made_with"]:
            if any(one.get(name) != ours.get(name) for name in ("mujoco-warp", "warp-lang")):
                return False
    return is_physics_of(content["physics"], experiment)


def check_same_experiment(directory: Path, held: Experiment, wanted: Mapping[str, Any]) -> None:
    """Refuses to continue a run with other settings than those it was begun with.

    Args:
      directory: Folder of the run.
      held: Experiment that the run's folder stores.
      wanted: Values that the user asked for; the keys are names of the experiment's fields.

    Raises:
      InputError: a value differs from the stored one.
    """
    for name, value in wanted.items():
        if value == (own := getattr(held, name)):
            continue
        if name == "settings" and sorted(value) == sorted(own):
            continue
        if name == "brain":
            own, value = held.brain_name, brain_name(value)
        if name == "kinematics":
            own = overrides_of(held.kinematics, Kinematics())
            value = overrides_of(wanted["kinematics"], held.kinematics)
        if name in ("kinematics", "settings"):
            own, value = " ".join(own) or "none", " ".join(value) or "none"
        raise InputError(f"{directory} holds an experiment with {name} {own}, not {value}")
