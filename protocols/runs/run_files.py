"""Reads and writes the results of a run.

`results.safetensors.gz` holds what was measured, see `run.Lives`: for each condition, the arrays
"task/proposer/events", "task/proposer/minutes", "task/proposer/valid" and the networks,
"task/proposer/before/..." and "task/proposer/after/...". The file is written atomically, with a
digest of all its arrays and the fields of its experiment. `robots.csv` is an export for people.
"""

from __future__ import annotations

import csv
import dataclasses
import io
import os
from pathlib import Path

import numpy as np

from ..errors import DamagedFileError, InputError
from ..storage import (
    check_folder,
    is_draft,
    load_arrays,
    resolved,
    save_arrays,
    write_atomically,
)
from ..terminal import notice
from .conditions import Condition
from .experiment import Experiment
from .manifest import MANIFEST, check_identity, read_manifest, same_physics
from .plan import Plan
from .run import Lives, Measured, Robot, Run, results_of

RESULTS_FILE, ROBOTS_FILE, TABLES_FILE = "results.safetensors.gz", "robots.csv", "tables.md"
_COLUMNS = tuple(field.name for field in dataclasses.fields(Robot))


def planned(directory: Path) -> Plan | None:
    """Returns the plan of the run that a folder holds; None if the folder can hold a new run.

    Raises:
      InputError: the path is a file, cannot be written, or holds something else.
    """
    try:
        check_folder(directory)
        if (directory / MANIFEST).exists():
            return read_manifest(directory)
        if directory.exists() and not all(map(is_draft, directory.iterdir())):
            raise InputError(f"{directory} is not empty and holds no experiment of musebot's")
    except OSError as error:
        raise InputError(f"{directory} cannot be used ({error.strerror})") from error
    return None


# ---- Results ----


def write_results(directory: Path, experiment: Experiment, measured: Measured) -> None:
    """Writes first robots.csv, then results.safetensors.gz: robots.csv is never the older file."""
    export_robots(directory, experiment, measured)
    arrays = {
        f"{condition}/{name}": array
        for condition, lives in measured.items()
        for name, array in lives.arrays().items()
    }
    save_arrays(directory / RESULTS_FILE, arrays, **dataclasses.asdict(experiment))


def export_robots(directory: Path, experiment: Experiment, measured: Measured) -> None:
    """Writes robots.csv, with a row for each robot; musebot does not read the file."""
    text = io.StringIO()
    writer = csv.DictWriter(text, _COLUMNS, lineterminator="\n")
    writer.writeheader()
    for part in results_of(experiment, measured).values():
        for robot in part.robots:
            row = dataclasses.asdict(robot)
            writer.writerow({name: "" if value != value else value for name, value in row.items()})
    write_atomically(directory / ROBOTS_FILE, text.getvalue().encode())


def read_measured(directory: Path, experiment: Experiment, networks: bool = True) -> Measured:
    """Reads the measurements of a run's robots; empty if none has finished yet.

    Args:
      directory: Folder of the run.
      experiment: Experiment of the run; the file with the results must name the same one.
      networks: Whether to read the networks; if not, or if the run is kept without networks,
        `before` and `after` are empty.

    Raises:
      DamagedFileError: the file is damaged, or of another experiment.
    """
    path = directory / RESULTS_FILE
    if not os.path.lexists(path):
        return {}

    try:
        arrays, notes = load_arrays(path)
    except FileNotFoundError as error:  # a link to nothing
        raise DamagedFileError(str(error)) from error
    check_identity(path, notes, dataclasses.asdict(experiment))
    if not networks:
        arrays = {name: array for name, array in arrays.items() if name.count("/") == 2}
    found: dict[Condition, dict[str, np.ndarray]] = {}
    try:
        for name, array in arrays.items():
            task, proposer, own = name.split("/", 2)
            found.setdefault(Condition(task, proposer), {})[own] = array
        return {condition: Lives.of(own) for condition, own in sorted(found.items())}
    except (ValueError, KeyError, InputError) as error:  # another file of the run
        raise DamagedFileError(f"{path} holds no results ({error})") from error


def check_kept_networks(directory: Path, measured: Measured) -> None:
    """Raises InputError if a run is kept without the networks of its robots."""
    if any(condition.has_brain and not lives.after for condition, lives in measured.items()):
        raise InputError(f"{directory} is kept without the networks of its robots")


# ---- Runs ----


def read_run(directory: Path, *, replay: bool = False, networks: bool = True) -> Run:
    """Reads the finished robots of a run.

    Args:
      directory: Folder of the run.
      replay: Whether the run's brains will drive robots again; a notice then warns if this
        version has another physics than the run.
      networks: Whether to read the networks, too; must be False for a run kept without networks.

    Raises:
      InputError: the folder holds no run or no finished robots, a file is damaged, or networks are
        missing.
    """
    if not os.path.isdir(directory):  # False, unlike Path's, below a folder that is closed to us
        raise InputError(f"there is no folder {directory}")
    if not os.path.isfile(directory / MANIFEST):
        inside = sorted(path.parent.name for path in directory.glob(f"*/{MANIFEST}"))
        runs = f"; it has the runs {', '.join(inside[:9])}" if inside else ""
        raise InputError(f"{directory} holds no experiment of musebot's{runs}")
    experiment = read_manifest(directory).experiment
    measured = read_measured(directory, experiment, networks)
    if networks:
        check_kept_networks(directory, measured)
    if not measured:
        raise InputError(
            f"{directory} holds no finished robots yet; `musebot run {directory}` continues it"
        )
    results = results_of(experiment, measured)
    if replay and not same_physics(directory):
        notice(
            f"{directory} was simulated in another physics than this version's, in which its "
            "brains now run"
        )
    if replay and experiment.physics != "c":
        notice(f"{directory} was simulated in MuJoCo Warp; its brains now run in C MuJoCo")
        experiment = dataclasses.replace(experiment, physics="c", device="cpu")
    return Run(resolved(directory).name, experiment, results)
