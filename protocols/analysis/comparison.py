"""Two runs side by side: every cell of the tables, by how much they differ, and how surely."""

from __future__ import annotations

import dataclasses
import functools
import math
from collections.abc import Callable, Container, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import InputError
from ..experiment.experiment import Experiment, differing
from ..experiment.schedules import SCHEDULES
from ..reporting import tables
from ..results.learn_ability import CATEGORIES, category
from ..results.results import Results, Robot, abilities, shares, test_seconds
from ..terminal import bar
from . import intervals
from .hypothesis_tests import holm, same_share, same_statistic
from .intervals import Interval

ALPHA = 0.05  # of a whole family of cells
CELLS = len(CATEGORIES) + 4  # of a condition
_RESAMPLES = 10_000  # of `outcomes`, at least: a verdict does not hang on who was dealt where

mean = np.nanmean
deviation = functools.partial(np.nanstd, ddof=1)


@dataclasses.dataclass(frozen=True)
class Side:
    """One of two runs.

    Attributes:
      name: of its folder.
      experiment: what decided its lives.
      results: its lives.
    """

    name: str
    experiment: Experiment
    results: Results

    def newborn(self, task: str, proposer: str) -> dict[str, np.ndarray]:
        """A condition's brains at birth, by tensor, each of shape (robots, ...)."""
        prefix = f"{task}/{proposer}/before/"
        return {k: v for k, v in self.results.brains.items() if k.startswith(prefix)}


@dataclasses.dataclass(frozen=True)
class Cell:
    """A cell of table 1 or 2 in two runs.

    Attributes:
      task: whose table.
      proposer: whose column.
      name: of the row.
      share: whether it is a share of the robots.
      paired: whether the two runs' robots were born with the same brains and are pairs.
      robots: how many have a value in it, ours and the other's.
      ours: its value.
      other: its value in the other run.
      interval: of ours minus other.
      p: two-sided, of the data if the two runs' robots are of one kind; NaN if not tested.
      corrected: p after Holm's correction over the cells that it was tested with.
    """

    task: str
    proposer: str
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
    def difference(self) -> float:
        """Ours minus other."""
        return self.ours - self.other

    @property
    def differs(self) -> bool:
        """Whether the two runs do, after the correction."""
        return self.corrected < ALPHA


def names_of(outs: Sequence[Path]) -> list[str]:
    """What runs are called: their folders' names, or where two are alike the ways there."""
    names = [out.resolve().name for out in outs]
    return names if len({*names}) == len(names) else [str(out) for out in outs]


def described(name: str, experiment: Experiment) -> str:
    """What a run is, as a line of Markdown: its brain, and whatever else is not the default."""
    fields = differing(experiment, Experiment(brain=experiment.brain))
    others = "".join(f", {name} {value}" for name, (value, _) in fields.items())
    return f"- {name}: brain {experiment.brain_name}{others}"


def shared_conditions(ours: Side, other: Side) -> list[tuple[str, str]]:
    """The conditions that both runs have lives of, in the tables' order.

    Raises:
      InputError: there are none, or the lives are of different lengths.
    """
    scales = ours.experiment.time_scale, other.experiment.time_scale
    if scales[0] != scales[1]:
        raise InputError(
            f"{ours.name} and {other.name} cannot stand side by side: their durations are the "
            f"paper's times {scales[0]:g} and {scales[1]:g}"
        )
    courses = ours.experiment.course, other.experiment.course
    if courses[0] != courses[1]:
        raise InputError(
            f"{ours.name} and {other.name} cannot stand side by side: their courses are "
            f"{courses[0]} and {courses[1]}"
        )
    theirs = other.results.conditions()
    both = [condition for condition in ours.results.conditions() if condition in theirs]
    if not both:
        raise InputError(f"{ours.name} and {other.name} have no task and proposer in common")
    return both


def are_pairs(ours: Side, other: Side, condition: tuple[str, str]) -> bool:
    """Whether robots of the same number, if both runs have it, were born with the same brain."""
    first, second = ours.newborn(*condition), other.newborn(*condition)
    if not first or first.keys() != second.keys():
        return False
    both = min(len(next(iter(brains.values()))) for brains in (first, second))
    return all(np.array_equal(first[name][:both], second[name][:both]) for name in first)


def compare(
    ours: Side,
    other: Side,
    condition: tuple[str, str],
    resamples: int,
    against: tuple[str, str] | None = None,
    only: Container[str] | None = None,
) -> list[Cell]:
    """The cells of a condition's column, ours against other, not corrected yet.

    Invalid lives are left out; of pairs, both. So are robots that have no partner, where one of
    two runs of pairs has more.

    Args:
      ours: a run.
      other: another.
      condition: task and proposer; both have lives of it.
      resamples: of the permutation tests.
      against: the other's condition, of the same task, whose robots are no pairs; None for the
        same.
      only: names of the cells that are wanted; None for all.
    """
    paired = against is None and are_pairs(ours, other, condition)
    rows = [ours.results.of(*condition), other.results.of(*(against or condition))]
    if paired:
        rows = [side[: min(map(len, rows))] for side in rows]
    sound = [np.array([row.valid for row in side]) for side in rows]
    if paired:
        sound = [sound[0] & sound[1]] * 2
    first, second = (
        _measures(side, condition[0], [row for row, ok in zip(own, keep, strict=True) if ok])
        for side, own, keep in zip((ours, other), rows, sound, strict=True)
    )
    found = []
    for name, values in first.items():
        if only is not None and name not in only:
            continue
        pair = values, second[name]
        if values.dtype == bool:
            test = intervals.difference_of_shares(*pair, paired), same_share(*pair, paired)
            summary = _value(values, np.mean), _value(second[name], np.mean)
        else:
            statistic = deviation if name == "sd of L" else mean
            test = (
                intervals.difference(*pair, statistic, paired),
                same_statistic(*pair, statistic, paired, resamples),
            )
            summary = _value(values, statistic), _value(second[name], statistic)
        robots = _count(values), _count(second[name])
        found.append(Cell(*condition, name, values.dtype == bool, paired, robots, *summary, *test))
    return found


def _count(values: np.ndarray) -> int:
    return int((~np.isnan(values.astype(float))).sum())


@dataclasses.dataclass(frozen=True)
class Match:
    """Whose robots are to be set against whose; the arguments of `compare`."""

    ours: Side
    other: Side
    condition: tuple[str, str]
    against: tuple[str, str] | None = None


def outcomes(matches: Sequence[Match]) -> list[tuple[Cell, Cell]]:
    """Who does better: the cells of mean L and of the time after training.

    Args:
      matches: all that are decided together.

    Returns:
      Both cells of each match, corrected over all of them.
    """
    resamples = max(_RESAMPLES, resamples_for(2 * len(matches)))
    cells: list[Cell] = []
    with bar() as progress:
        for match in progress.track(matches, description="comparing"):
            only = "mean L", tables.row_names(match.condition[0])[-1]
            pair = match.ours, match.other
            cells += compare(*pair, match.condition, resamples, match.against, only)
    found = iter(corrected(cells))
    return list(zip(found, found, strict=True))


def verdict(cell: Cell) -> str:
    """Whether ours are better or worse in a cell of `outcomes`, or it is undecided."""
    if not cell.differs:
        return "undecided"
    good = cell.name == "mean L" or SCHEDULES[cell.task].wanted
    return "better" if (cell.difference > 0) == good else "worse"


def _measures(side: Side, task: str, rows: Sequence[Robot]) -> dict[str, np.ndarray]:
    """What each cell of a column is made of, by row, shape (robots,); bool for categories."""
    found = abilities(rows)
    kinds = np.array([category(ability) for ability in found], dtype=object)
    *names, _, _, post = tables.row_names(task)[1:]
    seconds = test_seconds(side.experiment, task)
    members = {n: kinds == kind for n, kind in zip(names, CATEGORIES, strict=True)}
    return {
        **members,
        "mean L": found,
        "sd of L": found,
        post.replace("post", "pre"): shares(rows, seconds, "pre"),
        post: shares(rows, seconds, "post"),
    }


def _value(values: np.ndarray, statistic: Callable[..., np.ndarray]) -> float:
    measured = values[~np.isnan(values)]
    few = 2 if statistic is deviation else 1
    return float(statistic(measured)) if len(measured) >= few else float("nan")


def resamples_for(family: int) -> int:
    """Permutations, so that ten are expected beyond the sharpest border of Holm's."""
    return round(10 * family / ALPHA)


def corrected(cells: Sequence[Cell]) -> list[Cell]:
    """The cells with their p values corrected over all of them, by Holm's method."""
    values = holm(np.array([cell.p for cell in cells]))
    return [
        dataclasses.replace(cell, corrected=float(value))
        for cell, value in zip(cells, values, strict=True)
    ]


def all_cells(ours: Side, other: Side) -> list[Cell]:
    """All cells of both tables that both runs fill, corrected together.

    Raises:
      InputError: there are none, or the lives are of different lengths.
    """
    conditions = shared_conditions(ours, other)
    found: list[Cell] = []
    with bar() as progress:
        for condition in progress.track(conditions, description="comparing"):
            found += compare(ours, other, condition, resamples_for(CELLS * len(conditions)))
    return corrected(found)


def markdown(ours: Side, other: Side, cells: Sequence[Cell]) -> str:
    """Both tables as Markdown, what the runs differ in, and which cells do."""
    found = [cell for cell in cells if cell.differs]
    verdict = f"After Holm's correction {len(found)} of {len(cells)} cells differ"
    lines = [f"**{ours.name}** beside **{other.name}**. {_differ_in(ours, other)}", ""]
    lines += [f"{verdict}{':' if found else '.'}", ""]
    lines += [f"- {cell.task}, {cell.proposer}: {words(cell)}" for cell in found]
    lines += [""] * bool(found)
    for task in tables.TITLES:
        if any(cell.task == task for cell in cells):
            lines += [f"### {tables.title(task, ours.experiment, other.experiment)}", ""]
            lines += [*table(ours.name, other.name, [c for c in cells if c.task == task]), ""]
    return "\n".join([*lines, note(cells)])


def _differ_in(ours: Side, other: Side) -> str:
    fields = differing(ours.experiment, other.experiment)
    if not fields:
        return (
            "Their experiments are the same: only the versions and machines that lived them "
            "can differ."
        )
    named = "; ".join(f"{name} ({a}, {b})" for name, (a, b) in fields.items())
    if len(fields) == 1:
        return f"Their experiments differ in {named}."
    return (
        f"Their experiments differ in {len(fields)} fields, so that no difference below can be "
        f"laid to one of them: {named}."
    )


def note(cells: Sequence[Cell]) -> str:
    """How cells that were corrected together were compared, in words."""
    paired = [cell.paired for cell in cells]
    pairs = "Robots of the same number were born with the same brain and are compared in pairs"
    if not any(paired):
        pairs = "The robots are no pairs: they were born with different brains"
    elif not all(paired):
        pairs += f" where that is so, in {sum(paired)} of {len(cells)} cells"
    tests = ["McNemar's" if any(paired) else "", "Fisher's" if not all(paired) else ""]
    return (
        f"{pairs}. In brackets the 95 % interval of the difference: Newcombe's for shares of "
        "robots, BCa bootstrap for the rest. *p*: two-sided, "
        f"{' or '.join(filter(None, tests))} exact test for shares, a permutation test for the "
        f"rest; *Holm*: corrected over {len(cells)} cells, bold below {ALPHA:g}. A dash: too few "
        "measured robots.\n"
    )


def table(first: str, second: str, cells: Sequence[Cell]) -> list[str]:
    """Cells of one task as the lines of a table; the two runs by these names."""
    head = ["", "", first, second, "difference", "p", "Holm"]
    rows = [head, ["---", "---", *["---:"] * 5]]
    for cell in cells:
        holms = probability(cell.corrected)
        values = [
            number(cell, cell.ours),
            number(cell, cell.other),
            difference(cell),
            probability(cell.p),
        ]
        rows.append([cell.proposer, cell.name, *values, f"**{holms}**" if cell.differs else holms])
    return ["| " + " | ".join(row) + " |" for row in rows]


def words(cell: Cell) -> str:
    """A cell's two values and their difference, in a few words."""
    values = f"{number(cell, cell.ours)} against {number(cell, cell.other)}"
    return f"{cell.name} {values}, {difference(cell)}"


def number(cell: Cell, value: float) -> str:
    """One of a cell's values: shares of robots in per cent."""
    if math.isnan(value):
        return "-"
    return f"{value:.1%}" if cell.share else f"{value:.4f}"


def difference(cell: Cell) -> str:
    """A cell's difference, with its interval in brackets."""
    form = "+.1%" if cell.share else "+.3f"
    if math.isnan(cell.difference):
        return "-"
    text = f"{cell.difference:{form}}"
    low, high = cell.interval
    return text if math.isnan(low) or math.isnan(high) else f"{text} [{low:{form}}, {high:{form}}]"


def probability(value: float) -> str:
    """A p value; a dash for NaN."""
    if math.isnan(value):
        return "-"
    return "< 0.0001" if value < 1e-4 else f"{value:.4f}"


def as_json(ours: Side, other: Side, cells: Sequence[Cell]) -> dict[str, Any]:
    """The comparison as plain data; NaN as None."""

    def plain(cell: Cell) -> dict[str, Any]:
        fields = dataclasses.asdict(cell) | {"difference": cell.difference}
        interval = None if math.isnan(sum(cell.interval)) else list(cell.interval)
        numbers = {k: None if x != x else x for k, x in fields.items() if k != "interval"}
        return numbers | {"interval": interval, "differs": cell.differs}

    return {
        "ours": ours.name,
        "other": other.name,
        "differ_in": differing(ours.experiment, other.experiment),
        "interval_level": intervals.LEVEL,
        "alpha": ALPHA,
        "cells": [plain(cell) for cell in cells],
    }
