"""The file `experiment.json`: what is simulated, in which physics, by which versions.

The module also checks whether files and folders belong to an experiment.
"""

from __future__ import annotations

import contextlib
import dataclasses
import functools
import json
import os
import platform
import subprocess
from collections.abc import Mapping
from importlib import metadata
from pathlib import Path
from typing import Any

from ... import __version__
from ...fields import shown
from ..errors import DamagedFileError, InputError
from ..storage import read_json, write_json
from .conditions import Condition
from .experiment import Experiment, experiment_from, flat
from .physics_probe import is_physics_of, physics_probe
from .plan import Plan

MANIFEST = "experiment.json"
FORMAT = 1
_LAST_COMMIT = "9e668f6"  # the last that reads runs from before formats had numbers
VALUES = ("experiment", "plan", "format", "physics", "made_with", "digest")
_WARP = ("mujoco-warp", "warp-lang")
# The packages that compute results.
_PACKAGES = ("mujoco", "dm-control", "numpy", "scipy", "torch", "numba", *_WARP)

# Exceptions that are raised where values are not those of an experiment.
UNREADABLE = (ValueError, KeyError, TypeError, AttributeError, ArithmeticError)


def write_manifest(directory: Path, plan: Plan, begun: bool = True) -> None:
    """Writes `experiment.json`: the plan, its physics, and the versions that simulate it.

    If the run has `begun`, versions in an existing file are kept: they have simulated robots.
    """
    path = directory / MANIFEST
    earlier: list[Any] = []
    if begun and path.exists():
        earlier = [one for one in read_json(path)["made_with"] if one != made_with()]
    experiment = plan.experiment
    robots = sorted(plan.robots.items())  # a run that was continued has them in this order
    content = {
        "format": FORMAT,
        "experiment": dataclasses.asdict(experiment),
        "plan": [{"task": c.life, "proposer": c.proposer, "robots": n} for c, n in robots],
        "physics": physics_probe(experiment.body, experiment.kinematics),
        "made_with": [*earlier, made_with()],
    }
    write_json(path, content)


def read_manifest(directory: Path) -> Plan:
    """Reads the plan of a run.

    Raises:
      FileNotFoundError: the folder holds no `experiment.json`.
      DamagedFileError: the file is damaged, not musebot's, or of another format.
    """
    path = directory / MANIFEST
    content = read_json(path)
    if (number := content.get("format", "none")) != FORMAT:
        raise DamagedFileError(
            f"{path} must have the format {FORMAT}, got {shown(number)}: the commit {_LAST_COMMIT} "
            "is the last that reads runs without a format"
        )
    try:
        robots = {Condition(r["task"], r["proposer"]): r["robots"] for r in content["plan"]}
        return Plan(experiment_from(content["experiment"]), robots)
    except (*UNREADABLE, InputError) as error:
        text = f"{error!r:.200}"
        raise DamagedFileError(f"{path} is not an experiment of musebot's ({text})") from error


# ---- Identity ----


def check_identity(
    path: Path, held: Mapping[str, Any], wanted: Mapping[str, Any], what: str = "an experiment"
) -> None:
    """Checks that a file or a folder belongs to the wanted experiment or study.

    Args:
      path: File or folder, for the error's text.
      held: Values that the file stores, by name, as plain data or dataclasses. If the file lacks
        a field of `Experiment`, the field's default is used.
      wanted: Values that the file must store, by name; it may store others.
      what: Kind of thing that the file describes, such as "a run", for the error's text.

    Raises:
      DamagedFileError: a value is missing or differs; the text has its name, such as "brain.noise".
    """
    # As JSON, in which tuples are lists.
    given = [held, wanted, Experiment()]
    held, wanted, defaults = json.loads(json.dumps(given, default=dataclasses.asdict))
    held = _completed(held, {name: defaults[name] for name in defaults if name in wanted})
    for values in (held, wanted):
        if isinstance(values.get("settings"), list):
            values["settings"].sort(key=str)  # their order changes nothing
    if all(name in held and held[name] == value for name, value in wanted.items()):
        return
    own, other = flat({name: held.get(name) for name in wanted}), flat(wanted)
    names = [name for name in {**other, **own} if own.get(name) != other.get(name)]
    name = [*names, *wanted][0]
    values = own.get(name), other.get(name)
    first, second = (f"{v:.60}" if isinstance(v, str) else shown(v) for v in values)
    raise DamagedFileError(f"{path} holds {what} with {name} {first}, not {second}")


def _completed(held: Any, defaults: Any) -> Any:
    """Returns `held`, in which missing values, nested ones too, are filled by defaults."""
    if not (isinstance(held, dict) and isinstance(defaults, dict)):
        return held
    own = {name: _completed(held.get(name, value), value) for name, value in defaults.items()}
    return held | own


# ---- Physics ----


def same_physics(directory: Path) -> bool:
    """Returns whether a run was simulated in the physics of this version."""
    content = read_json(directory / MANIFEST)
    experiment = experiment_from(content["experiment"])
    # Each version of these compilers rounds in its own way.
    packages = _WARP if experiment.physics == "warp" else ()
    packages += ("numba",) if experiment.backend == "numba" else ()
    if packages:
        versions = [[m.get(n) for n in packages] for m in (made_with(), *content["made_with"])]
        if any(one != versions[0] for one in versions):
            return False
    return is_physics_of(content["physics"], experiment)


# ---- Versions ----


def made_with() -> dict[str, Any]:
    """Returns the versions, the processor and the system of this process, for JSON."""
    versions = {}
    for name in _PACKAGES:
        with contextlib.suppress(metadata.PackageNotFoundError):  # an extra is missing
            versions[name] = metadata.version(name)
    return {
        "python": platform.python_version(),
        "musebot": __version__,
        "commit": _commit(),
        **versions,
        "cpu": _cpu(),
        "cores": os.cpu_count(),
        "platform": platform.platform(),
    }


@functools.cache
def _commit() -> str | None:
    """Returns this package's commit, with "-dirty" if files differ from it; None without Git."""
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
