"""The benchmark's page: scores of learners (rows) in lives (columns), and their adaptation."""

from __future__ import annotations

import dataclasses
import functools
import math
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np

from ...tasks.lives import Life
from ..analysis import intervals
from ..analysis.adaptation import FAILED, RECOVERED, WINDOW, Adaptation, Newborns
from ..analysis.hypothesis_tests import ALPHA, holm, same_mean
from ..pages import style
from ..pages.markdown import mean_cell, number, probability, table, with_interval
from ..progress import tracked
from .bounds import UNTAUGHT, Matrix
from .study import Page

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_MOST_DRAWN = 6  # learners in a figure
_ABOUT = (
    "Score: share of time in which a robot reaches what its world rewards, scaled in each phase so "
    "that an untrained robot has 0 and a policy made for the world (in a drift: for one of twelve "
    "worlds) 1, and averaged over the whole "
    "life. Brackets: 95 % intervals. Bold: the best learner of a life, and all that do not differ "
    f"significantly from it (p at least {ALPHA}, permutation tests of means, Holm over the "
    "learners)."
)
_MEASURES = (
    f"Failed: lives with a score below {FAILED}. Worst tenth: mean score of the tenth of the "
    "robots with the lowest. Recovery: the first minute of a phase (counted from 1) that begins "
    f"{WINDOW} minutes with a mean score of at least {RECOVERED:g}, at the last visit of each "
    "world, over that of newborns in the same world; below 1 the old robot is faster. Last: the "
    "same after the last change only. Slope: change of the logarithm (to base 2) of recovery from "
    "one phase to the next, in worlds that return; positive: recovery becomes slower with age. "
    "Savings: by which share recovery is faster at the last return of a world, other than that of "
    "birth, than at the first visit, with p of a permutation test of pairs (Holm over the "
    f"learners). Forgotten: mean score of the last {WINDOW} minutes of a visit less that of the "
    f"first {WINDOW} of the next one."
)
_MINUTES = (
    "Minutes of recovery of old robots at the first and at the last visit of each world, and of "
    "newborns. The world of birth is first visited by newborns. Brackets: the shares that never "
    "recover; they count with the whole phase, which draws ratios towards 1."
)


@dataclasses.dataclass(frozen=True)
class Row:
    """A learner in a life.

    Attributes:
      name: Name of the learner, or of a brain and its proposer.
      curves: Share of each of M minutes that each of n robots was at the goal, shape (n, M).
      old: Measures of how these n robots adapted in the phases of the life.
      newborns: Minutes of recovery of newborn robots, an array for each world. If no world of the
        life occurs twice, there is only the array of the first world.
    """

    name: str
    curves: np.ndarray
    old: Adaptation
    newborns: Newborns

    @property
    def score(self) -> float:
        """Mean online score; minus infinity if a life is too short for one."""
        return float(np.nan_to_num(self.old.online.mean(), nan=-np.inf))


@dataclasses.dataclass(frozen=True)
class Column:
    """A life with its bounds and its learners."""

    life: Life
    matrix: Matrix
    rows: Sequence[Row]

    def ranked(self) -> list[Row]:
        """Returns the learners, that with the largest mean online score first."""
        return sorted(self.rows, key=lambda row: (-row.score, row.name))

    @functools.cached_property
    def tests(self) -> Mapping[str, float]:
        """p, corrected by Holm, of each learner's difference from the best one, by name."""
        best, *others = self.ranked()
        values = [
            same_mean(best.old.online, row.old.online, paired=False)
            for row in tracked(others, f"comparing scores in {self.life.name}")
        ]
        return dict(zip([row.name for row in others], holm(np.array(values)), strict=True))

    @functools.cached_property
    def savings_tests(self) -> Mapping[str, float]:
        """p, corrected by Holm, of each learner's difference between first and last visits."""
        pairs = [row.old.first_and_last() for row in self.rows]
        values = [
            math.nan if np.isnan(pair).any() else same_mean(*pair, paired=True) for pair in pairs
        ]
        return dict(zip([row.name for row in self.rows], holm(np.array(values)), strict=True))


def page(columns: Sequence[Column], time_scale: float = 1.0) -> Page:
    """Returns the benchmark's page of some lives, whose durations are scaled by `time_scale`."""
    lines = ["## Scores", ""]
    if time_scale < 1:
        lines += [f"A rehearsal, all durations times {time_scale:g}: its numbers mean nothing.", ""]
    lines += [*table(_summary(columns)), "", _ABOUT, "", _MEASURES, ""]
    figures = {}
    with style.styled():
        for column in columns:
            lines += [f"## {column.life.title}", "", *table(_measures(column)), ""]
            if len(column.rows[0].newborns) > 1:
                lines += [*table(_recovery(column)), "", _MINUTES, ""]
            lines += [*table(_bounds(column.matrix)), ""]
            best = f"{column.matrix.best_fixed:.3f} of the time in all worlds"
            lines += [f"The best of these policies reaches {best}.", ""]
            figures[column.life.name] = draw(column)
    return Page("\n".join(lines), figures)


def _summary(columns: Sequence[Column]) -> list[list[str]]:
    """Returns the table of all learners, sorted by score in the first life, then the next ones."""
    cells: dict[str, list[str]] = {}
    scores: dict[str, list[float]] = {}
    for place, column in enumerate(columns):
        for row in column.rows:
            text = mean_cell(row.old.online)
            best = column.tests.get(row.name, 1.0) >= ALPHA  # not if NaN: too few for a test
            if best and text != "-":
                text = f"**{text}**"
            cells.setdefault(row.name, ["-"] * len(columns))[place] = text
            scores.setdefault(row.name, [-math.inf] * len(columns))[place] = row.score
    names = sorted(cells, key=lambda name: ([-score for score in scores[name]], name))
    head = ["learner", *(column.life.title.lower() for column in columns)]
    return [head, *([name, *cells[name]] for name in names)]


def _measures(column: Column) -> list[list[str]]:
    """Returns the table of a life, with a row for each learner."""
    head = "learner,robots,score,failed,worst tenth,recovery,last,slope,savings,forgotten,p"
    rows: list[list[str]] = [[*head.split(",")]]
    for row in column.ranked():
        old, count = row.old, len(row.old.online)
        failed = with_interval(
            f"{old.failed.mean():.2f}", intervals.share(int(old.failed.sum()), count), ".2f"
        )
        if np.isnan(old.online).any():  # a shortened life with equal bounds has no scores
            failed = "-"
        relative, slope = ["-", "-"], "-"
        if len(row.newborns) > 1:
            found = (old.last_recovery(row.newborns, n) for n in (len(row.newborns), 1))
            relative = [with_interval(f"{mean:.2f}", interval, ".2f") for mean, interval in found]
            slope = f"{old.slope(row.newborns):+.3f}"
        p = column.tests.get(row.name, math.nan)
        saved = number(old.savings(), "+.2f")
        if not math.isnan(chance := column.savings_tests[row.name]):
            saved += f" (p {probability(chance)})"
        last = saved, number(old.forgetting(), "+.2f")
        worst = number(old.worst_tenth(), ".3f")
        cells = [mean_cell(old.online), failed, worst, *relative, slope, *last]
        rows.append([row.name, str(count), *cells, "" if math.isnan(p) else probability(p)])
    return rows


def _recovery(column: Column) -> list[list[str]]:
    """Returns the table of recovery in each world of a life, with a row for each learner."""
    phases, count = column.life.phases, len(column.life.worlds)
    rows = []
    for row in column.ranked():
        cells = [row.name]
        for visits, newborns in zip(row.old.visits(), row.newborns, strict=True):
            groups = *row.old.recovery[:, visits[[0, -1]]].T, newborns
            minutes = ", ".join(f"{one.mean():.1f}" for one in groups)
            whole = phases[visits[-1]].minutes
            never = ", ".join(f"{100 * (one >= whole).mean():.0f} %" for one in groups)
            cells.append(f"{minutes} ({never})")
        rows.append(cells)
    return [["minutes", *(f"world {number + 1}" for number in range(count))], *rows]


def _bounds(matrix: Matrix) -> list[list[str]]:
    """Returns the table of the shares of time that policies reach in the worlds of a life."""
    worlds = [f"world {number + 1}" for number in matrix.worlds]
    policies = [f"policy of {world}" for world in worlds]
    rows = zip([*policies, *UNTAUGHT], matrix.shares, strict=True)
    cells = ([name, *(f"{share:.3f}" for share in own), f"{own.mean():.3f}"] for name, own in rows)
    return [["share of time", *worlds, "mean"], *cells]


def draw(column: Column) -> Figure:
    """Draws the best learners' shares of time over the life: robots thin, their mean thick."""
    rows = column.ranked()[:_MOST_DRAWN]
    figure, axes = style.canvas(1.3 * len(rows) + 0.6, len(rows), 1, sharex=True, sharey=True)
    for axis, row in zip(axes.flat, rows, strict=True):
        hours, points = smoothed(row.curves)
        axis.plot(hours, points.T, color="0.75", linewidth=0.3)
        axis.plot(hours, points.mean(axis=0), color=style.CURVE, linewidth=1.5)
        style.mark_changes(axis, column.life)
        axis.set_title(row.name, fontsize=8, loc="left")
        style.in_per_cent(axis, 1.0)
    axes.flat[-1].set_xlabel("hours of life")
    return figure


def smoothed(curves: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Returns the middles in [h], (k,), of k spans of 5 minutes, and the curves' means, (n, k)."""
    width = min(WINDOW, curves.shape[1])
    whole = curves.shape[1] // width * width
    points = curves[:, :whole].reshape(len(curves), -1, width).mean(axis=2)
    return (np.arange(points.shape[1]) + 0.5) * width / 60, points
