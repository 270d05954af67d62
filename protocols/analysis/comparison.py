"""Two runs compared: the difference of every cell of the tables, its interval and its p-value."""

from __future__ import annotations

import dataclasses
import functools

import numpy as np

from ..errors import InputError, RunError
from ..progress import tracked
from ..runs.cohort import make_agent, random_streams
from ..runs.conditions import CohortKey, Condition
from ..runs.experiment import Experiment
from ..runs.learn_ability import CATEGORIES
from ..runs.run import Run
from . import intervals
from .hypothesis_tests import ALPHA, holm, same_deviation, same_mean, same_share
from .intervals import Interval
from .paper_tables import row_names

_deviation = functools.partial(np.nanstd, ddof=1)


@dataclasses.dataclass(frozen=True)
class Cell:
    """A cell of table 1 or 2 in two runs."""

    condition: Condition  # column of the table
    name: str  # row of the table
    share: bool  # whether the value is a share of the robots
    paired: bool  # whether the robots of the two runs are pairs with the same initial brain
    robots: tuple[int, int]  # numbers of compared robots: in our run, and in the other run
    incomplete: int  # number of pairs that are left out because only one robot has a value
    ours: float  # value in our run
    other: float  # value in the other run
    interval: Interval  # 95 % confidence interval of the difference `ours` - `other`
    p: float  # two-sided, under the null hypothesis of equal robots; NaN if not tested
    corrected: float = float("nan")  # p after Holm's correction over the family of cells

    @property
    def difference(self) -> float:
        """Our run's value minus the other run's."""
        return self.ours - self.other

    @property
    def differs(self) -> bool:
        """Whether the difference is significant after Holm's correction."""
        return self.corrected < ALPHA


def _shared_conditions(ours: Run, other: Run) -> list[Condition]:
    """Returns the conditions that both runs have; raises InputError, see `compare_runs`."""
    first, second = (run.experiment.time_scale for run in (ours, other))
    if first != second:
        raise InputError(
            f"{ours.name} and {other.name} cannot be compared: "
            f"their time scales are {first} and {second}"
        )
    theirs = other.conditions()
    both = [condition for condition in ours.conditions() if condition in theirs]
    if not both:
        raise InputError(f"{ours.name} and {other.name} have no task and proposer in common")
    for task in {condition.life for condition in both}:
        if ours.experiment.life_of(task) != other.experiment.life_of(task):
            raise InputError(f"{ours.name} and {other.name} have two lives of the name {task}")
    return both


def is_paired(ours: Run, other: Run, condition: Condition) -> bool:
    """Returns whether robots with the same number have the same initial brain in both runs.

    A run may be kept without brains, so the brains of each run's first cohort are made again.
    """
    streams = ("seed", "cohort_size", "device")  # they also begin agents without random weights
    if any(getattr(ours.experiment, one) != getattr(other.experiment, one) for one in streams):
        return False
    try:
        first, second = (_newborns(run.experiment, condition) for run in (ours, other))
    except (InputError, RunError):  # the agent is not trusted or not found
        return False
    shared = first.keys() & second.keys()  # one brain may have state that the other lacks
    return bool(shared) and all(np.array_equal(first[name], second[name]) for name in shared)


def _newborns(experiment: Experiment, condition: Condition) -> dict[str, np.ndarray]:
    experiment = dataclasses.replace(experiment, backend="torch")  # Numba's brains begin the same
    seed, _ = random_streams(experiment.seed, CohortKey(condition, 0))
    return make_agent(experiment, condition, experiment.cohort_size, seed).weights()


def _column(ours: Run, other: Run, condition: Condition) -> list[Cell]:
    """Compares the cells of a condition's column; the p-values are not corrected yet.

    Invalid robots are left out. In paired runs, their partners and robots without a partner are
    left out, too. Each cell leaves out pairs in which a robot has no value (a genius has no L).
    """
    paired = is_paired(ours, other, condition)
    first, second = (_measures(run, condition) for run in (ours, other))
    if paired:
        rows = [run.valid_rows(condition) for run in (ours, other)]
        _, *both = np.intersect1d(*rows, assume_unique=True, return_indices=True)
        first, second = (
            {name: values[chosen] for name, values in side.items()}
            for side, chosen in zip((first, second), both, strict=True)
        )
    return [
        _cell(condition, name, (values, second[name]), paired) for name, values in first.items()
    ]


def _measures(run: Run, condition: Condition) -> dict[str, np.ndarray]:
    """Returns the values of n valid robots by name of the cell, (n,); bool for categories."""
    life = run.experiment.life_of(condition.life)
    if not life.tested:
        return {f"share of time {life.event}": run.life_shares(condition)}
    kinds = np.array(run.classes(condition), dtype=object)
    *names, _, _, post = row_names(life)[1:]
    return {
        **{name: kinds == kind for name, kind in zip(names, CATEGORIES, strict=True)},
        "mean L": run.abilities(condition),
        "sd of L": run.abilities(condition),
        post.replace("post", "pre"): run.shares(condition, "pre"),
        post: run.shares(condition, "post"),
    }


def _cell(
    condition: Condition, name: str, pair: tuple[np.ndarray, np.ndarray], paired: bool
) -> Cell:
    known = [~np.isnan(values.astype(float)) for values in pair]
    incomplete = 0
    if paired:
        both, incomplete = known[0] & known[1], int((known[0] ^ known[1]).sum())
        pair, known = (pair[0][both], pair[1][both]), [both[both]] * 2
    first, second = (values[own] for values, own in zip(pair, known, strict=True))
    share = first.dtype == bool
    statistic = np.mean
    if share:
        interval = intervals.difference_of_shares(first, second, paired)
        p = same_share(first, second, paired)
    elif name == "sd of L":
        statistic = _deviation
        interval = intervals.difference(*pair, _deviation, paired)
        p = same_deviation(first, second, paired)
    else:
        span = intervals.ABILITY if name == "mean L" else intervals.SHARE
        interval = intervals.difference_of_means(*pair, paired, span)
        p = same_mean(first, second, paired)
    fewest = 2 if statistic is _deviation else 1
    one, two = (float(statistic(x)) if len(x) >= fewest else float("nan") for x in (first, second))
    sizes = len(first), len(second)
    return Cell(condition, name, share, paired, sizes, incomplete, one, two, interval, p)


def compare_runs(ours: Run, other: Run) -> list[Cell]:
    """Compares all cells of both tables that both runs have; Holm corrects all p-values together.

    Shows the progress.

    Raises:
      InputError: the runs share no condition, or their lives or time scales differ.
    """
    found: list[Cell] = []
    for condition in tracked(_shared_conditions(ours, other), "comparing"):
        found += _column(ours, other, condition)
    values = holm(np.array([cell.p for cell in found]))
    return [
        dataclasses.replace(cell, corrected=float(value))
        for cell, value in zip(found, values, strict=True)
    ]
