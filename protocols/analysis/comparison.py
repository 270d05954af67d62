"""Two runs compared: the difference of every cell of the tables, its interval and its p-value."""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Callable, Collection, Sequence

import numpy as np

from ..errors import InputError
from ..lives.conditions import Condition
from ..lives.learn_ability import CATEGORIES, classes
from ..lives.run import Robot, Run, abilities, shares
from ..lives.schedules import SCHEDULES
from ..terminal import StepProgress
from . import intervals
from .hypothesis_tests import ALPHA, DRAWS, holm, same_deviation, same_mean, same_share
from .intervals import Interval
from .paper_tables import row_names

CELLS = len(CATEGORIES) + 4  # of a condition

_deviation = functools.partial(np.nanstd, ddof=1)


@dataclasses.dataclass(frozen=True)
class Match:
    """Two groups of robots to compare.

    Attributes:
      ours: A run.
      other: The run to compare with; may be `ours` itself.
      condition: Condition of the robots of our run.
      against: Condition of the robots of the other run, with the same task; None means `condition`.
        Robots of two different conditions are independent groups.
    """

    ours: Run
    other: Run
    condition: Condition
    against: Condition | None = None

    def is_paired(self) -> bool:
        """Returns whether robots with the same number have the same initial brain in both runs."""
        if self.against is not None:
            return False
        first, second = (run.networks(self.condition, "before") for run in (self.ours, self.other))
        shared = first.keys() & second.keys()  # one brain may have state that the other lacks
        both = min((len(side[name]) for side in (first, second) for name in shared), default=0)
        return bool(shared) and all(
            np.array_equal(first[name][:both], second[name][:both]) for name in shared
        )


@dataclasses.dataclass(frozen=True)
class Cell:
    """A cell of table 1 or 2 in two runs.

    Attributes:
      condition: Column of the table.
      name: Row of the table.
      share: Whether the value is a share of the robots.
      paired: Whether the robots of the two runs are pairs with the same initial brain.
      robots: Two numbers of robots that have a value: in our run, and in the other run.
      ours: Value in our run.
      other: Value in the other run.
      interval: 95 % confidence interval of the difference `ours` - `other`.
      p: Two-sided p-value under the null hypothesis of equal robots; NaN if not tested.
      corrected: p after Holm's correction over the family of cells; NaN before the correction.
    """

    condition: Condition
    name: str
    share: bool
    paired: bool
    robots: tuple[int, int]
    ours: float
    other: float
    interval: Interval
    p: float
    corrected: float = float("nan")

    @property
    def task(self) -> str:
        """Task of the condition."""
        return self.condition.task

    @property
    def proposer(self) -> str:
        """Proposer of the condition."""
        return self.condition.proposer

    @property
    def difference(self) -> float:
        """Our value minus the other."""
        return self.ours - self.other

    @property
    def differs(self) -> bool:
        """Whether the difference is significant after the correction."""
        return self.corrected < ALPHA


def shared_conditions(ours: Run, other: Run) -> list[Condition]:
    """Returns the conditions that both runs have, in the order of the tables.

    Raises:
      InputError: the runs share no condition, or their schedules differ.
    """
    for what, name in (("time scales", "time_scale"), ("protocols", "protocol")):
        first, second = (getattr(run.experiment, name) for run in (ours, other))
        if first != second:
            raise InputError(
                f"{ours.name} and {other.name} cannot be compared: "
                f"their {what} are {first} and {second}"
            )
    theirs = other.conditions()
    both = [condition for condition in ours.conditions() if condition in theirs]
    if not both:
        raise InputError(f"{ours.name} and {other.name} have no task and proposer in common")
    return both


def compare(match: Match, only: Collection[str] | None = None, draws: int = DRAWS) -> list[Cell]:
    """Compares the cells of a condition's column; the p-values are not corrected yet.

    Invalid robots are left out. In paired runs, their partners and robots without a partner are
    left out too.

    Args:
      match: Robots to compare.
      only: Names of the wanted cells; None for all.
      draws: Largest number of permutations of each test.
    """
    paired, condition = match.is_paired(), match.condition
    rows = [match.ours.robots(condition), match.other.robots(match.against or condition)]
    if paired:
        rows = [side[: min(map(len, rows))] for side in rows]
    valid = [np.array([row.valid for row in side]) for side in rows]
    if paired:
        valid = [valid[0] & valid[1]] * 2
    first, second = (
        _measures(run, condition.task, [row for row, ok in zip(own, keep, strict=True) if ok])
        for run, own, keep in zip((match.ours, match.other), rows, valid, strict=True)
    )
    return [
        _cell(condition, name, (values, second[name]), paired, draws)
        for name, values in first.items()
        if only is None or name in only
    ]


def _measures(run: Run, task: str, rows: Sequence[Robot]) -> dict[str, np.ndarray]:
    """Returns each robot's value by name of the cell, shape (robots,); bool for categories."""
    rows = [*rows]
    found = abilities(rows)
    kinds = np.array(classes(found, run.exact_classes), dtype=object)
    *names, _, _, post = row_names(task)[1:]
    seconds = run.test_seconds(task)
    members = {n: kinds == kind for n, kind in zip(names, CATEGORIES, strict=True)}
    return {
        **members,
        "mean L": found,
        "sd of L": found,
        post.replace("post", "pre"): shares(rows, seconds, "pre"),
        post: shares(rows, seconds, "post"),
    }


def _cell(
    condition: Condition,
    name: str,
    pair: tuple[np.ndarray, np.ndarray],
    paired: bool,
    draws: int,
) -> Cell:
    share = pair[0].dtype == bool
    statistic = _deviation if name == "sd of L" else np.mean if share else np.nanmean
    if share:
        interval = intervals.difference_of_shares(*pair, paired)
        p = same_share(*pair, paired)
    elif statistic is _deviation:
        interval = intervals.difference(*pair, statistic, paired)
        p = same_deviation(*pair, paired, draws)
    else:
        span = intervals.ABILITY if name == "mean L" else intervals.SHARE
        interval = intervals.difference_of_means(*pair, paired, span)
        p = same_mean(*pair, paired, draws)
    robots = _count(pair[0]), _count(pair[1])
    ours, other = (_value(values, statistic) for values in pair)
    return Cell(condition, name, share, paired, robots, ours, other, interval, p)


def _count(values: np.ndarray) -> int:
    return int((~np.isnan(values.astype(float))).sum())


def _value(values: np.ndarray, statistic: Callable[..., np.ndarray]) -> float:
    measured = values[~np.isnan(values)]
    few = 2 if statistic is _deviation else 1
    return float(statistic(measured)) if len(measured) >= few else float("nan")


def corrected(cells: Sequence[Cell]) -> list[Cell]:
    """Returns the cells with their p-values corrected over all of them, by Holm's method."""
    values = holm(np.array([cell.p for cell in cells]))
    return [
        dataclasses.replace(cell, corrected=float(value))
        for cell, value in zip(cells, values, strict=True)
    ]


def compare_runs(ours: Run, other: Run) -> list[Cell]:
    """Compares all cells of both tables that both runs have, corrected together.

    Raises:
      InputError: the runs share no condition, or their schedules differ.
    """
    matches = [Match(ours, other, condition) for condition in shared_conditions(ours, other)]
    return compare_all(matches)


def compare_all(
    matches: Sequence[Match],
    only: Callable[[Match], Collection[str] | None] = lambda match: None,
) -> list[Cell]:
    """Compares the cells of all matches, corrected together, and shows the progress.

    Args:
      matches: Robots to compare.
      only: Function that returns the names of a match's cells to compare, or None for all.
    """
    wanted = [only(match) for match in matches]
    family = sum(CELLS if names is None else len(names) for names in wanted)
    # Holm's smallest threshold is ALPHA / family: 50 permutations beyond it, or more.
    draws = max(DRAWS, 1000 * family)
    found: list[Cell] = []
    with StepProgress("comparing", len(matches)) as progress:
        for match, names in zip(matches, wanted, strict=True):
            found += compare(match, names, draws)
            progress.advance()
    return corrected(found)


def outcomes(matches: Sequence[Match]) -> list[tuple[Cell, Cell]]:
    """Compares who performs better: mean L, and the time after training.

    Args:
      matches: All robots to compare; the p-values of all their cells are corrected together.

    Returns:
      For each match, two cells: mean L, and the share of time in contact (or in the spot) in the
      test after training.
    """
    cells = compare_all(matches, lambda match: ("mean L", row_names(match.condition.task)[-1]))
    found = iter(cells)
    return list(zip(found, found, strict=True))


def verdict(cell: Cell) -> str:
    """Returns whether our run is "better", "worse" or "undecided" in a cell of `outcomes`."""
    if not cell.differs:
        return "undecided"
    higher_is_better = cell.name == "mean L" or SCHEDULES[cell.task].wanted
    return "better" if (cell.difference > 0) == higher_is_better else "worse"
