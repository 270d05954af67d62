"""The one reader and writer of a run's results: robots.csv, curves.npz, brains.safetensors."""

from __future__ import annotations

import csv
import dataclasses
import io
import zipfile
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from ..errors import DamagedFileError, InputError
from ..experiment.conditions import Condition
from ..experiment.manifest import MANIFEST, read_manifest, same_physics
from ..experiment.plan import Plan
from ..storage import check_folder, is_draft, load_arrays, save_arrays, write_atomically
from ..terminal import notice
from .learn_ability import INVALID
from .results import WHEN, ConditionResults, NetworkArrays, Results, Robot, When, category_in
from .run import Run

ROBOTS_FILE, CURVES_FILE, BRAINS_FILE = "robots.csv", "curves.npz", "brains.safetensors"
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


def read_run(directory: Path, name: str = "", *, replay: bool = False) -> Run:
    """Reads a run that has finished robots.

    Args:
      directory: Folder of the run.
      name: Name of the run; empty for the folder's name.
      replay: Whether the run's brains will drive robots again; a notice then warns of a physics
        that differs from this version's.

    Raises:
      InputError: the folder holds no such run, or what it holds is damaged.
    """
    if not (directory / MANIFEST).is_file():
        raise InputError(f"{directory} holds no experiment of musebot's")
    experiment, results = read_manifest(directory).experiment, read_results(directory)
    if not results:
        raise InputError(
            f"{directory} holds no finished robots yet; `musebot run {directory}` continues it"
        )
    if replay and not same_physics(directory):
        notice(
            f"{directory} was simulated in another physics than this version's, in which its "
            "brains now run"
        )
    return Run(name or directory.resolve().name, experiment, results)


def read_runs(directories: Sequence[Path], *, replay: bool = False) -> list[Run]:
    """Reads several runs, with distinct names.

    Raises:
      InputError: there is none, one is given twice, or see `read_run`.
    """
    if not directories:
        raise InputError("at least one run is needed")
    if len({directory.resolve() for directory in directories}) < len(directories):
        raise InputError("a run is given twice")
    names = run_names(directories)
    return [read_run(d, n, replay=replay) for n, d in zip(names, directories, strict=True)]


def run_names(directories: Sequence[Path]) -> list[str]:
    """Returns the folders' names, or the paths as given where two names are equal."""
    names = [directory.resolve().name for directory in directories]
    return names if len({*names}) == len(names) else [str(directory) for directory in directories]


def flat_networks(results: Results, when: Sequence[When] = WHEN) -> NetworkArrays:
    """Returns all networks, named as in the file: "task/proposer/before|after/network.tensor"."""
    return {
        f"{condition}/{w}/{name}": array
        for condition, part in results.items()
        for w in when
        for name, array in part.networks[w].items()
    }


def write_results(directory: Path, results: Results) -> None:
    """Writes the three files, each atomically; robots.csv last.

    Raises:
      OSError: a file cannot be written.
    """
    save_arrays(directory / BRAINS_FILE, flat_networks(results))
    curves = {str(condition): part.curves for condition, part in results.items()}
    buffer = io.BytesIO()
    np.savez_compressed(buffer, **dict(sorted(curves.items())))  # type: ignore[arg-type]
    write_atomically(directory / CURVES_FILE, buffer.getvalue())
    text = io.StringIO()
    writer = csv.DictWriter(text, _COLUMNS, lineterminator="\n")
    writer.writeheader()
    for part in results.values():
        for robot in part.robots:
            ability = "" if np.isnan(robot.learn_ability) else robot.learn_ability
            writer.writerow(dataclasses.asdict(robot) | {"learn_ability": ability})
    write_atomically(directory / ROBOTS_FILE, text.getvalue().encode())


def read_results(directory: Path) -> Results:
    """Reads the three files; returns no results without robots.csv, which is written last.

    Raises:
      DamagedFileError: a file is damaged or missing, or the files contradict each other.
    """
    if not (directory / ROBOTS_FILE).exists():
        return {}
    try:
        robots = read_robots(directory / ROBOTS_FILE)
        curves = _read_curves(directory / CURVES_FILE)
        brains, _ = load_arrays(directory / BRAINS_FILE)
    except FileNotFoundError as error:
        raise DamagedFileError(f"{directory} lacks a file ({error})") from error
    rows: dict[Condition, list[Robot]] = {}
    for robot in robots:
        rows.setdefault(Condition(robot.task, robot.proposer), []).append(robot)
    return {
        condition: _condition_results(directory, condition, rows[condition], curves, brains)
        for condition in sorted(rows)
    }


def _condition_results(
    directory: Path,
    condition: Condition,
    robots: list[Robot],
    curves: Mapping[str, np.ndarray],
    brains: NetworkArrays,
) -> ConditionResults:
    """Cuts curves and networks to the rows of robots.csv, which is written last."""
    if str(condition) not in curves:
        raise DamagedFileError(f"{directory / CURVES_FILE} lacks {condition}")

    def cut(name: str, array: np.ndarray) -> np.ndarray:
        if len(array) < len(robots):
            raise DamagedFileError(f"{directory} has fewer robots in {name} than rows")
        return array[: len(robots)]

    networks: dict[When, NetworkArrays] = {}
    for when in WHEN:
        prefix = f"{condition}/{when}/"
        networks[when] = {
            name.removeprefix(prefix): cut(name, array)
            for name, array in brains.items()
            if name.startswith(prefix)
        }
    return ConditionResults(robots, cut(str(condition), curves[str(condition)]), networks)


def read_robots(path: Path) -> list[Robot]:
    """Reads robots.csv.

    Raises:
      FileNotFoundError: there is no such file.
      DamagedFileError: the file is not a table of robots.
    """
    try:
        with path.open(newline="", encoding="utf-8") as file:
            reader = csv.DictReader(file, strict=True)
            if tuple(reader.fieldnames or ()) != _COLUMNS:
                raise DamagedFileError(f"{path} is not a table of robots")
            return [_robot(row) for row in reader]
    except (ValueError, TypeError, InputError, csv.Error) as error:
        raise DamagedFileError(f"{path} is damaged ({error})") from error


def _robot(row: Mapping[str, str]) -> Robot:
    if None in row or None in row.values():
        raise ValueError("a row has another number of cells than the head")
    condition = Condition(row["task"], row["proposer"])
    ability = float(row["learn_ability"] or "nan")
    if row["category"] not in (category_in(condition.task, ability), INVALID):
        raise ValueError(
            f"{row['category']!r} is not the class of {condition.task} with an L of {ability}"
        )
    return Robot(
        condition.task,
        condition.proposer,
        int(row["seed"]),
        int(row["cohort"]),
        int(row["robot"]),
        float(row["t_pre_s"]),
        float(row["t_post_s"]),
        ability,
        row["category"],
    )


def _read_curves(path: Path) -> dict[str, np.ndarray]:
    try:
        with zipfile.ZipFile(path) as archive:
            if name := archive.testzip():  # numpy alone does not check every checksum
                raise DamagedFileError(f"{path} is damaged (in {name})")
        with np.load(path, allow_pickle=False) as file:
            return {name: file[name] for name in file.files}
    except (DamagedFileError, FileNotFoundError):
        raise
    except Exception as error:  # zipfile, zlib and numpy each have many exceptions for damage
        raise DamagedFileError(f"{path} is damaged ({error})") from error
