"""The one reader and writer of a run's results: robots.csv, curves.npz, brains.safetensors."""

from __future__ import annotations

import contextlib
import csv
import dataclasses
import io
import os
import re
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from types import MappingProxyType
from typing import Any, Literal

import numpy as np

from ..errors import DamagedFileError, InputError
from ..storage import (
    Shapes,
    check_folder,
    digest_of,
    digest_of_file,
    encoded_arrays,
    is_draft,
    load_arrays,
    read_whole,
    resolved,
    write_atomically,
)
from ..terminal import notice
from .checks import (
    check_curves,
    check_network_shapes,
    check_networks,
    check_rows,
)
from .conditions import Condition
from .curves_file import read_curves
from .manifest import (
    MANIFEST,
    read_manifest,
    record_files,
    recorded_files,
    same_physics,
)
from .plan import Plan
from .results import WHEN, ConditionResults, NetworkArrays, Results, Robot, When
from .run import Run

ROBOTS_FILE, CURVES_FILE, BRAINS_FILE = "robots.csv", "curves.npz", "brains.safetensors"
FILES = (BRAINS_FILE, CURVES_FILE, ROBOTS_FILE)  # in the order of writing
TABLES_FILE = "tables.md"
Needs = Literal["rows", "curves", "brains"]
"""What is read of a run: rows of robots.csv, with curves, or with curves and brains."""
_FILES_OF: Mapping[Needs, tuple[str, ...]] = MappingProxyType(
    {"rows": (ROBOTS_FILE,), "curves": (CURVES_FILE, ROBOTS_FILE), "brains": FILES}
)
_COLUMNS = tuple(field.name for field in dataclasses.fields(Robot))
_WHOLE = re.compile(r"(0|[1-9][0-9]{0,60})")
_DECIMAL = re.compile(r"-?[0-9]{1,30}(\.[0-9]{1,30})?(e[-+]?[0-9]{1,4})?")
_MOST_BYTES_OF_ROW = 4096


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


def read_so_far(directory: Path, needs: Needs = "brains") -> Run:
    """Reads the robots that a run has collected; it has none without robots.csv.

    Args:
      directory: Folder of the run.
      needs: What is read, see `read_results`.

    Raises:
      InputError: the folder holds no run, or what it holds is damaged.
    """
    if not (directory / MANIFEST).is_file():
        raise InputError(_no_run(directory))
    experiment = read_manifest(directory).experiment
    return Run(resolved(directory).name, experiment, read_results(directory, needs))


def _no_run(directory: Path) -> str:
    """Returns why a folder cannot be read as a run, and which of its folders can."""
    if not directory.exists():
        return f"there is no folder {directory}"
    inside = sorted(path.parent.name for path in directory.glob(f"*/{MANIFEST}"))
    more = f" and {len(inside) - 9} more" if len(inside) > 9 else ""
    runs = f"; it has the runs {', '.join(inside[:9])}{more}" if inside else ""
    return f"{directory} holds no experiment of musebot's{runs}"


def read_run(
    directory: Path, name: str = "", *, replay: bool = False, needs: Needs = "brains"
) -> Run:
    """Reads a run that has finished robots.

    Args:
      directory: Folder of the run.
      name: Name of the run; empty for the folder's name.
      replay: Whether the run's brains will drive robots again; a notice then warns of a physics
        that differs from this version's.
      needs: What is read, see `read_results`.

    Raises:
      InputError: the folder holds no such run, or what it holds is damaged.
    """
    run = read_so_far(directory, needs)
    if not run.results:
        raise InputError(
            f"{directory} holds no finished robots yet; `musebot run {directory}` continues it"
        )
    if not recorded_files(directory):
        notice(
            f"{directory} has no digests of its files, as an older version wrote it: a changed "
            "file may not be recognised"
        )
    experiment = run.experiment
    if replay and not same_physics(directory):
        notice(
            f"{directory} was simulated in another physics than this version's, in which its "
            "brains now run"
        )
    if replay and experiment.physics != "c":
        notice(f"{directory} was simulated in MuJoCo Warp; its brains now run in C MuJoCo")
        experiment = dataclasses.replace(experiment, physics="c", device="cpu")
    return Run(name or run.name, experiment, run.results)


def read_runs(
    directories: Sequence[Path], *, replay: bool = False, needs: Needs = "brains"
) -> list[Run]:
    """Reads several runs, with distinct names.

    Args:
      directories: Folders of the runs.
      replay: See `read_run`.
      needs: What is read, see `read_results`.

    Raises:
      InputError: there is none, one is given twice, or see `read_run`.
    """
    if not directories:
        raise InputError("at least one run is needed")
    if len({resolved(directory) for directory in directories}) < len(directories):
        raise InputError("a run is given twice")
    pairs = zip(directories, run_names(directories), strict=True)
    return [read_run(*pair, replay=replay, needs=needs) for pair in pairs]


def run_names(directories: Sequence[Path]) -> list[str]:
    """Returns the folders' names, with as many folders above them as make the names differ."""
    paths = [resolved(directory) for directory in directories]
    for length in range(1, max((len(path.parts) for path in paths), default=0) + 1):
        names = ["/".join(path.parts[-length:]) for path in paths]
        if len({*names}) == len(names):
            return names
    return [str(directory) for directory in directories]  # a folder is given twice


def check_names(directories: Sequence[Path]) -> None:
    """Raises InputError where two runs have the same name, under which a study keeps its files."""
    names = [resolved(directory).name for directory in directories]
    if len({*names}) < len(names):
        raise InputError(f"the runs must have different names, got {', '.join(names)}")


def flat_networks(results: Results, when: Sequence[When] = WHEN) -> NetworkArrays:
    """Returns all networks, named as in the file: "task/proposer/before|after/network.tensor"."""
    return {
        f"{condition}/{w}/{name}": array
        for condition, part in results.items()
        for w in when
        for name, array in part.networks[w].items()
    }


def write_results(directory: Path, results: Results) -> None:
    """Writes the three files, each atomically; their digests first, robots.csv last.

    Raises:
      OSError: a file cannot be written.
    """
    contents = _contents(results)
    if (directory / ROBOTS_FILE).exists():
        adopt_files(directory)
    record_files(directory, {name: digest_of(contents[name]) for name in FILES})
    for name in FILES:
        write_atomically(directory / name, contents[name])


def adopt_files(directory: Path) -> None:
    """Records the digests of a finished run that an earlier version has written without them.

    Raises:
      OSError: `experiment.json` cannot be written.
    """
    if not recorded_files(directory):
        record_files(directory, {name: digest_of_file(directory / name) for name in FILES})


def _contents(results: Results) -> dict[str, bytes]:
    """Returns the contents of the three files by name."""
    curves = {str(condition): part.curves for condition, part in results.items()}
    buffer = io.BytesIO()
    np.savez_compressed(buffer, **dict(sorted(curves.items())))  # type: ignore[arg-type]
    text = io.StringIO()
    writer = csv.DictWriter(text, _COLUMNS, lineterminator="\n")
    writer.writeheader()
    for part in results.values():
        for robot in part.robots:
            ability = "" if np.isnan(robot.learn_ability) else robot.learn_ability
            writer.writerow(dataclasses.asdict(robot) | {"learn_ability": ability})
    return {
        BRAINS_FILE: encoded_arrays(flat_networks(results)),
        CURVES_FILE: buffer.getvalue(),
        ROBOTS_FILE: text.getvalue().encode(),
    }


def read_results(directory: Path, needs: Needs = "brains") -> Results:
    """Reads a run's files; returns no results without robots.csv, which is written last.

    Every value is checked: against the plan of experiment.json, and against the other files. Each
    file must be one whose digest experiment.json has, if it has any.

    Args:
      directory: Folder of the run.
      needs: What is read: "rows" reads robots.csv alone, "curves" also curves.npz, "brains" all
        three files. Curves that are not read have the shape (n, 0); networks are then empty. A
        finished run may be kept without what nobody reads.

    Raises:
      DamagedFileError: a file is damaged or missing, or the files contradict each other.
    """
    if not os.path.lexists(directory / ROBOTS_FILE):
        return {}
    curves = brains = None
    try:
        plan = read_manifest(directory)
        rows = read_robots(directory / ROBOTS_FILE, plan)
        if needs != "rows":
            curves = read_curves(directory / CURVES_FILE, plan)
        if needs == "brains":
            brains = _read_brains(directory / BRAINS_FILE, plan)
    except FileNotFoundError as error:
        raise DamagedFileError(f"{directory} lacks a file ({error})") from error
    # First: of files that contradict each other, one was changed.
    _check_digests(directory, _FILES_OF[needs])
    return {
        condition: _condition_results(directory, plan, (condition, rows[condition]), curves, brains)
        for condition in sorted(rows)
    }


def is_kept_without_brains(directory: Path, plan: Plan, needs: Needs) -> bool:
    """Returns whether a folder has what is needed of all robots of a plan, but not their brains.

    Args:
      directory: Folder of the run.
      plan: Robots that are wanted.
      needs: What is needed of them, see `read_results`.

    Raises:
      DamagedFileError: robots.csv is damaged.
    """
    if os.path.lexists(directory / BRAINS_FILE):
        return False
    there = all(os.path.lexists(directory / name) for name in _FILES_OF[needs])
    return there and has_all_rows(directory, plan)


def has_all_rows(directory: Path, plan: Plan) -> bool:
    """Returns whether a folder's robots.csv has all robots of a plan.

    Raises:
      DamagedFileError: robots.csv is damaged.
    """
    if not (directory / MANIFEST).is_file():
        return False
    run = read_so_far(directory, "rows")
    return all(len(run.robots(c)) >= robots for c, robots in plan.robots.items())


def _check_digests(directory: Path, names: Sequence[str]) -> None:
    """Raises DamagedFileError where a file is not one that was written for this run."""
    found = {name: digest_of_file(directory / name) for name in names}
    # Read after the files: a run that is enlarged meanwhile has recorded them before.
    if not (states := recorded_files(directory)):
        return
    for name in reversed(names):  # a file is of the same state as robots.csv, or a later one
        known = [n for n, state in enumerate(states) if state.get(name) == found[name]]
        if not known:
            raise DamagedFileError(
                f"{directory / name} is not the file that musebot wrote for this run (its digest "
                f"is not the one in {MANIFEST})"
            )
        states = states[known[0] :]


def _condition_results(
    directory: Path,
    plan: Plan,
    rows: tuple[Condition, list[Robot]],
    curves: Mapping[str, np.ndarray] | None,
    brains: NetworkArrays | None,
) -> ConditionResults:
    """Cuts curves and networks to the rows of robots.csv, which is written last."""
    condition, robots = rows
    own_curves = np.empty((len(robots), 0))
    if curves is not None:
        own_curves = _own_curves(directory, plan, rows, curves)
    networks: dict[When, NetworkArrays] = {when: {} for when in WHEN}
    if brains is None:
        return ConditionResults(robots, own_curves, networks)
    for when in WHEN:
        prefix = f"{condition}/{when}/"
        networks[when] = {
            name.removeprefix(prefix): _cut(directory, name, array, len(robots))
            for name, array in brains.items()
            if name.startswith(prefix)
        }
    if condition.has_brain and not networks["after"]:
        raise DamagedFileError(f"{directory / BRAINS_FILE} lacks {condition}")
    with _damage(directory / BRAINS_FILE):
        valid = np.array([robot.valid for robot in robots])
        check_networks(plan.experiment, condition, networks, valid)
    return ConditionResults(robots, own_curves, networks)


def _own_curves(
    directory: Path,
    plan: Plan,
    rows: tuple[Condition, list[Robot]],
    curves: Mapping[str, np.ndarray],
) -> np.ndarray:
    condition, robots = rows
    if str(condition) not in curves:
        raise DamagedFileError(f"{directory / CURVES_FILE} lacks {condition}")
    own = _cut(directory, str(condition), curves[str(condition)], len(robots))
    with _damage(directory / CURVES_FILE, f"{condition}, "):
        check_curves(plan.experiment.schedule(condition.task), own, robots)
    return own


def _cut(directory: Path, name: str, array: np.ndarray, robots: int) -> np.ndarray:
    if len(array) < robots:
        raise DamagedFileError(f"{directory} has fewer robots in {name} than rows")
    return array[:robots]


@contextlib.contextmanager
def _damage(path: Path, where: str = "") -> Iterator[None]:
    """Turns a ValueError into the sentence that a file is damaged."""
    try:
        yield
    except (ValueError, TypeError, csv.Error) as error:
        raise DamagedFileError(f"{path} is damaged ({where}{error})") from error


def read_robots(path: Path, plan: Plan) -> dict[Condition, list[Robot]]:
    """Reads robots.csv: the rows of each condition that has any.

    Args:
      path: File to read.
      plan: Plan of the run.

    Raises:
      FileNotFoundError: there is no such file.
      DamagedFileError: the file is not a table of these robots.
    """
    rows: dict[Condition, dict[int, Robot]] = {}
    most = (sum(plan.robots.values()) + 1) * _MOST_BYTES_OF_ROW
    content = read_whole(path, most)
    with _damage(path):
        reader = csv.DictReader(io.StringIO(content.decode(), newline=""), strict=True)
        if tuple(reader.fieldnames or ()) != _COLUMNS:
            raise ValueError("it is not a table of robots")
        for number, row in enumerate(reader, start=2):
            try:
                robot = _robot(row)
                condition = Condition(robot.task, robot.proposer)
            except (ValueError, InputError) as error:
                raise ValueError(f"row {number}, {error}") from error
            rows.setdefault(condition, {})[number] = robot
        for condition, numbered in rows.items():
            check_rows(plan, condition, numbered)
    return {condition: [*numbered.values()] for condition, numbered in rows.items()}


def _robot(row: Mapping[str, str]) -> Robot:
    if None in row or None in row.values():
        raise ValueError("which has another number of cells than the head")
    values: dict[str, Any] = dict(row)
    for column in ("seed", "cohort", "robot"):
        if not _WHOLE.fullmatch(row[column]):
            raise ValueError(f"column {column}: must be a whole number, got {row[column]!r:.60}")
        values[column] = int(row[column])
    for column in ("t_pre_s", "t_post_s", "learn_ability"):
        text = row[column]
        if column == "learn_ability" and not text:
            values[column] = float("nan")
        elif not _DECIMAL.fullmatch(text):
            raise ValueError(f"column {column}: must be a number, got {text!r:.60}")
        else:
            values[column] = float(text)
    return Robot(**values)


def _read_brains(path: Path, plan: Plan) -> NetworkArrays:
    """Reads the networks; shapes are compared with the plan's before any array is read."""

    def check(shapes: Shapes) -> None:
        left = dict(shapes)
        for condition, robots in plan.robots.items():
            own = {n: left.pop(n) for n in [*left] if n.startswith(f"{condition}/")}
            if own:
                named = {n.removeprefix(f"{condition}/"): shape for n, shape in own.items()}
                check_network_shapes(plan.experiment, condition, named, robots)
        for name in left:
            raise ValueError(f"it has {name}, which is not planned")

    return load_arrays(path, check)[0]
