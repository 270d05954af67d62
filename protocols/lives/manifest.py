"""The file `experiment.json`: what is simulated, in which physics, by which versions.

It also answers whether files and folders are those of an experiment.
"""

from __future__ import annotations

import contextlib
import dataclasses
import functools
import json
import os
import platform
import reprlib
import subprocess
from collections.abc import Mapping, Sequence
from importlib import metadata
from pathlib import Path
from typing import Any

import numpy as np

from ... import __version__
from ...models import Kinematics
from ..errors import DamagedFileError, InputError
from ..storage import read_json, write_json
from .conditions import Condition
from .experiment import Body, Experiment, experiment_from
from .plan import Plan

MANIFEST = "experiment.json"
FORMAT = 1
_LAST_COMMIT = "9e668f6"  # reads what was written before there were numbers of formats
_VALUES = {"format", "experiment", "plan", "physics", "made_with", "digest"}
_REQUIRED = ("mujoco", "dm-control", "numpy", "scipy", "torch")  # those that compute results
_IDEAL = Kinematics()

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
    if begun and path.exists():
        made_with = [one for one in read_json(path)["made_with"] if one != machine()]
    experiment = plan.experiment
    robots = sorted(plan.robots.items())  # a run that was continued has them in this order
    content = {
        "format": FORMAT,
        "experiment": dataclasses.asdict(experiment),
        "plan": [{**dataclasses.asdict(condition), "robots": n} for condition, n in robots],
        "physics": physics_probe(experiment.body, experiment.kinematics),
        "made_with": [*made_with, machine()],
    }
    write_json(path, content)


def read_manifest(directory: Path) -> Plan:
    """Reads the plan of a run.

    Raises:
      FileNotFoundError: the folder holds no `experiment.json`.
      DamagedFileError: the file is damaged, foreign or of another format.
    """
    path = directory / MANIFEST
    content = read_json(path)
    if content.get("format", 0) != FORMAT:
        raise DamagedFileError(
            f"{path} must have the format {FORMAT}, got "
            f"{reprlib.repr(content.get('format', 'none'))}: the commit {_LAST_COMMIT} is the last "
            "that reads runs without a format"
        )
    try:
        if {*content} != _VALUES:
            raise ValueError(f"it must have {', '.join(sorted(_VALUES))}")
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


# ---- Whether it is of this experiment ----


def check_identity(path: Path, held: Mapping[str, Any], wanted: Mapping[str, Any]) -> None:
    """Checks that a file or a folder is of the experiment that is wanted.

    Args:
      path: File or folder.
      held: Values that it stores, by name, as plain data.
      wanted: Values that are wanted of it; it may store others besides. Plain data or dataclasses.

    Raises:
      DamagedFileError: a value is missing or differs; the text names it, as "brain.noise".
    """
    plain = json.loads(json.dumps(wanted, default=dataclasses.asdict))  # tuples become lists
    own = {name: value for name, value in held.items() if name in plain}
    if difference := _difference(own, plain):
        name, value, other = difference
        raise DamagedFileError(
            f"{path} holds an experiment with {name} {_shown(value)}, not {_shown(other)}"
        )


def _difference(held: Mapping, wanted: Mapping, group: str = "") -> tuple[str, Any, Any] | None:
    """Returns the name and both values of the first field that differs; None if all are equal."""
    for key in {**wanted, **held}:
        own, other = held.get(key), wanted.get(key)
        if isinstance(own, Mapping) and isinstance(other, Mapping):
            if found := _difference(own, other, f"{group}{key}."):
                return found
        elif own != other or key not in held or key not in wanted:
            return f"{group}{key}", own, other
    return None


def _shown(value: Any) -> str:
    return value[:60] if isinstance(value, str) else reprlib.repr(value)


# ---- Physics ----


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


@functools.cache
def physics_probe(body: Body = "mujoco", kinematics: Kinematics = _IDEAL) -> tuple[float, ...]:
    """Drives a robot into a wall and returns its pose and sensor readings there.

    A changed mass, friction or timestep changes these numbers; decoration does not. With
    non-default kinematics, robots also drive along a wall at several angles.

    Args:
      body: Body of the robot.
      kinematics: Parameters of the kinematic simulator.
    """
    experiment = Experiment(body=body, kinematics=kinematics)
    batch = experiment.batch("spot_finding", 1)
    batch.place(np.array([0]), np.array([[0.42, 0.05, 0.3]]))
    for motors in ((0.5, 0.4), (0.5, 0.5), (-0.2, 0.5), (0.1, -0.5)):
        for _ in range(4):
            batch.step(np.array([motors]))
    numbers = *batch.pose[0].tolist(), *batch.sensordata[0].tolist()
    if kinematics == _IDEAL:
        return numbers
    angles = np.radians(np.arange(5, 90, 10))
    grazing = experiment.batch("spot_finding", len(angles))
    east = np.full(len(angles), grazing.dimensions.half_length - grazing.dimensions.radius)
    grazing.place(np.arange(len(angles)), np.column_stack([east, 0 * east, angles]))
    for motor in (0.5, 0.3):
        for _ in range(4):
            grazing.step(np.full((len(angles), 2), motor))
    return (*numbers, *grazing.pose.ravel().tolist())


def is_physics_of(probe: Sequence[float], experiment: Experiment) -> bool:
    """Returns whether a stored probe equals this version's probe of an experiment's body."""
    ours = physics_probe(experiment.body, experiment.kinematics)
    return np.shape(ours) == np.shape(probe) and bool(np.allclose(probe, ours, rtol=0, atol=1e-6))


# ---- Versions ----


def machine() -> dict[str, Any]:
    """Returns the versions, the processor and the system of this process, for JSON."""
    return {
        "python": platform.python_version(),
        "musebot": __version__,
        "commit": _commit(),
        **{name: metadata.version(name) for name in _REQUIRED},
        **_versions("mujoco-warp", "warp-lang", "cmaes"),
        "cpu": _cpu(),
        "cores": os.cpu_count(),
        "platform": platform.platform(),
    }


def _versions(*names: str) -> dict[str, str]:
    """Returns the versions of those optional packages that are installed."""
    found = {}
    for name in names:
        with contextlib.suppress(metadata.PackageNotFoundError):
            found[name] = metadata.version(name)
    return found


@functools.cache
def _commit() -> str | None:
    """Returns the commit of this package, with "-dirty" if files differ; None without Git."""
    root = Path(__file__).parents[2]
    if not (root / ".git").exists():  # an installed copy, perhaps inside another repository
        return None
    command = ["git", "describe", "--always", "--dirty", "--abbrev=12", "--exclude=*"]
    with contextlib.suppress(OSError, subprocess.SubprocessError):
        found = subprocess.run(
            command, cwd=root, capture_output=True, text=True, check=True, timeout=10
        )
        return found.stdout.strip() or None
    return None


def _cpu() -> str:
    info = Path("/proc/cpuinfo")
    if info.exists():
        for line in info.read_text().splitlines():
            if line.startswith("model name"):
                return line.split(":", 1)[1].strip()
    return platform.processor()
