"""What a run leaves for its reader: robots.csv, curves.npz, brains.safetensors."""

from __future__ import annotations

import csv
import dataclasses
import io
import zipfile
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Literal

import numpy as np

from ...tasks import CONTROL_TIMESTEP
from ..errors import DamagedFileError, InputError
from ..experiment.experiment import CohortKey, Experiment, check_condition, condition_order
from ..experiment.schedules import SCHEDULES, control_steps
from ..simulation.cohort import Lives
from ..storage import load_arrays, save_arrays, write_atomically
from .learn_ability import INVALID, Summary, category, learn_ability, summarise

ROBOTS, CURVES, BRAINS = "robots.csv", "curves.npz", "brains.safetensors"


@dataclasses.dataclass(frozen=True)
class Robot:
    """A row of robots.csv.

    Attributes:
      task: what it had to learn.
      proposer: how its actions were proposed.
      seed: of the experiment.
      cohort: the number of its cohort within the condition.
      robot: its number within the condition.
      t_pre_s: seconds in contact, or in the spot, before training.
      t_post_s: the same after training.
      learn_ability: Eq. 4; NaN (an empty cell) for the unmeasured and the invalid.
      category: of tables 1 and 2; genius or ignorant for the unmeasured; or invalid.
    """

    task: str
    proposer: str
    seed: int
    cohort: int
    robot: int
    t_pre_s: float
    t_post_s: float
    learn_ability: float
    category: str

    @property
    def valid(self) -> bool:
        """Whether its simulation was stable to the end: all others count nowhere."""
        return self.category != INVALID


_COLUMNS = tuple(field.name for field in dataclasses.fields(Robot))


@dataclasses.dataclass
class Results:
    """All finished lives of a run.

    Attributes:
      robots: rows, in the order of task, proposer, robot.
      curves: by "task/proposer", each simulated minute's share in contact or in the spot,
        shape (robots, minutes).
      brains: by "task/proposer/before|after/network.tensor", shape (robots, ...).
    """

    robots: list[Robot]
    curves: dict[str, np.ndarray]
    brains: dict[str, np.ndarray]

    def conditions(self) -> list[tuple[str, str]]:
        """Pairs of task and proposer that have lives here, in the tables' order."""
        return sorted({(r.task, r.proposer) for r in self.robots}, key=condition_order)

    def proposers_of(self, task: str) -> list[str]:
        """Whose robots have lived a task, in the tables' order."""
        return [proposer for t, proposer in self.conditions() if t == task]

    def tasks(self) -> list[str]:
        """Which tasks have been lived, in the tables' order."""
        return list(dict.fromkeys(task for task, _ in self.conditions()))

    def of(self, task: str, proposer: str) -> list[Robot]:
        """The rows of a condition, invalid lives among them."""
        return [r for r in self.robots if (r.task, r.proposer) == (task, proposer)]

    def valid(self, task: str, proposer: str) -> list[Robot]:
        """The rows of a condition's valid lives."""
        return [row for row in self.of(task, proposer) if row.valid]

    def valid_curves(self, task: str, proposer: str) -> np.ndarray:
        """The curves of a condition's valid lives, shape (robots, minutes)."""
        rows = self.of(task, proposer)
        return self.curves[f"{task}/{proposer}"][[row.valid for row in rows]]

    def summary(self, experiment: Experiment, task: str, proposer: str) -> Summary:
        """The column of table 1 or 2 that a condition fills."""
        rows = self.valid(task, proposer)
        return summarise(
            abilities(rows),
            [row.t_post_s for row in rows],
            test_seconds(experiment, task),
            invalid=len(self.of(task, proposer)) - len(rows),
        )


def abilities(rows: Sequence[Robot]) -> np.ndarray:
    """L of each robot, NaN for the unmeasured, shape (n,)."""
    return np.array([row.learn_ability for row in rows], dtype=float)


def shares(rows: Sequence[Robot], test_seconds: float, part: Literal["pre", "post"]) -> np.ndarray:
    """Each robot's share of the test before or after training, in [0, 1], shape (n,)."""
    times = [row.t_pre_s if part == "pre" else row.t_post_s for row in rows]
    return np.array(times, dtype=float) / test_seconds


def test_seconds(experiment: Experiment, task: str) -> float:
    """How long the test after training lasts, in simulated seconds."""
    return experiment.schedule(task).steps_of("post") * CONTROL_TIMESTEP


def collect(experiment: Experiment, cohorts: Iterable[tuple[CohortKey, Lives]]) -> Results:
    """Turns finished cohorts into results."""
    robots: list[Robot] = []
    curves: dict[str, list[np.ndarray]] = {}
    brains: dict[str, list[np.ndarray]] = {}
    for key, lives in sorted(
        cohorts,
        key=lambda item: (*condition_order((item[0].task, item[0].proposer)), item[0].index),
    ):
        schedule = experiment.schedule(key.task)
        pre, post = (lives.events[:, part] * CONTROL_TIMESTEP for part in (0, 2))
        found = learn_ability(pre, post, schedule.wanted)
        for index, valid in enumerate(lives.valid):
            robots.append(
                Robot(
                    key.task,
                    key.proposer,
                    experiment.seed,
                    key.index,
                    key.index * experiment.cohort_size + index,
                    round(float(pre[index]), 1),
                    round(float(post[index]), 1),
                    float(found[index]) if valid else float("nan"),
                    category_in(key.task, found[index]) if valid else INVALID,
                )
            )
        condition = f"{key.task}/{key.proposer}"
        steps = np.full(lives.minutes.shape[1], control_steps(1), dtype=np.float32)
        steps[-1] = sum(schedule.steps()) - steps[:-1].sum()
        curves.setdefault(condition, []).append((lives.minutes / steps).astype(np.float32))
        for when, networks in (("before", lives.before), ("after", lives.after)):
            for name, array in networks.items():
                brains.setdefault(f"{condition}/{when}/{name}", []).append(array)
    return Results(robots, _joined(curves), _joined(brains))


def category_in(task: str, ability: float) -> str:
    """The category that a robot of a task is of: genius or ignorant if its L is NaN."""
    name = category(ability)
    return SCHEDULES[task].unmeasured if name == "unmeasured" else name


def merge(older: Results, newer: Results) -> Results:
    """Adds newer lives to older ones; a robot that both have is taken from the older."""
    known = {(r.task, r.proposer, r.robot) for r in older.robots}
    fresh = [r for r in newer.robots if (r.task, r.proposer, r.robot) not in known]
    result = Results(
        sorted(
            older.robots + fresh,
            key=lambda r: (*condition_order((r.task, r.proposer)), r.robot),
        ),
        dict(older.curves),
        dict(older.brains),
    )
    for task, proposer in newer.conditions():
        rows = newer.of(task, proposer)
        chosen = [
            i for i, row in enumerate(rows) if (row.task, row.proposer, row.robot) not in known
        ]
        order = np.argsort(
            [r.robot for r in older.of(task, proposer)] + [rows[i].robot for i in chosen]
        )
        for target, source in ((result.curves, newer.curves), (result.brains, newer.brains)):
            for name, array in source.items():
                if name.split("/")[:2] == [task, proposer]:
                    parts = [target[name]] if name in target else []
                    target[name] = np.concatenate([*parts, array[chosen]])[order]
    return result


def save(directory: Path, results: Results) -> None:
    """Writes the three files, each atomically.

    Raises:
      OSError: one cannot be written.
    """
    save_arrays(directory / BRAINS, results.brains)
    buffer = io.BytesIO()
    np.savez_compressed(buffer, **dict(sorted(results.curves.items())))  # type: ignore[arg-type]
    write_atomically(directory / CURVES, buffer.getvalue())
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(_COLUMNS)
    for robot in results.robots:
        cells = dataclasses.asdict(robot)
        if np.isnan(robot.learn_ability):
            cells["learn_ability"] = ""
        writer.writerow(cells.values())
    write_atomically(directory / ROBOTS, text.getvalue().encode())


def load(directory: Path) -> Results:
    """Reads the three files; without them, there are no lives yet.

    Raises:
      DamagedFileError: one is damaged, or they do not go together.
    """
    paths = [directory / name for name in (ROBOTS, CURVES, BRAINS)]
    if not paths[0].exists():  # written last: without it nothing was ever finished
        return Results([], {}, {})
    try:
        robots = read_robots(paths[0])
        curves = _read_curves(paths[1])
        brains, _ = load_arrays(paths[2])
    except FileNotFoundError as error:
        raise DamagedFileError(f"{directory} lacks a file ({error})") from error
    return _fitting(directory, Results(robots, curves, brains))


def _fitting(directory: Path, results: Results) -> Results:
    """Cuts curves and brains to the rows of robots.csv, which is written last."""
    for task, proposer in results.conditions():
        count = len(results.of(task, proposer))
        if f"{task}/{proposer}" not in results.curves:
            raise DamagedFileError(f"{directory / CURVES} lacks {task}/{proposer}")
        for arrays in (results.curves, results.brains):
            for name in [n for n in arrays if n.split("/")[:2] == [task, proposer]]:
                if len(arrays[name]) < count:
                    raise DamagedFileError(f"{directory} has fewer lives in {name} than rows")
                arrays[name] = arrays[name][:count]
    known = {f"{task}/{proposer}" for task, proposer in results.conditions()}
    for arrays in (results.curves, results.brains):
        for name in [n for n in arrays if "/".join(n.split("/")[:2]) not in known]:
            del arrays[name]
    return results


def read_robots(path: Path) -> list[Robot]:
    """Reads robots.csv.

    Raises:
      FileNotFoundError: there is none.
      DamagedFileError: it is not a table of robots.
    """
    try:
        with path.open(newline="", encoding="utf-8") as file:
            rows = list(csv.reader(file))
        if not rows or tuple(rows[0]) != _COLUMNS:
            raise DamagedFileError(f"{path} is not a table of robots")
        return [_robot(*row) for row in rows[1:]]
    except (ValueError, TypeError, InputError, csv.Error) as error:
        raise DamagedFileError(f"{path} is damaged ({error})") from error


def _robot(
    task: str, proposer: str, seed: str, cohort: str, robot: str,
    pre: str, post: str, ability: str, name: str,
) -> Robot:  # fmt: skip
    check_condition(task, proposer)
    value = float(ability) if ability else float("nan")
    if name not in (category_in(task, value), INVALID):
        raise ValueError(f"{name!r} is not the category of {task} with an L of {value}")
    return Robot(
        task, proposer, int(seed), int(cohort), int(robot), float(pre), float(post), value, name
    )


def _read_curves(path: Path) -> dict[str, np.ndarray]:
    try:
        with zipfile.ZipFile(path) as archive:
            if name := archive.testzip():  # numpy alone does not look at every checksum
                raise DamagedFileError(f"{path} is damaged (in {name})")
        with np.load(path, allow_pickle=False) as file:
            return {name: file[name] for name in file.files}
    except (DamagedFileError, FileNotFoundError):
        raise
    except Exception as error:  # zipfile, zlib and numpy each have many words for damage
        raise DamagedFileError(f"{path} is damaged ({error})") from error


def _joined(parts: Mapping[str, list[np.ndarray]]) -> dict[str, np.ndarray]:
    return {name: np.concatenate(arrays) for name, arrays in parts.items()}
