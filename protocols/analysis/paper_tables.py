"""Tables 1 and 2: the paper's columns, and the columns that a run fills, with 95 % intervals."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from types import MappingProxyType

import numpy as np

from ...tasks.lives import Life
from ..runs.conditions import Condition
from ..runs.learn_ability import CATEGORIES, Summary
from ..runs.run import Run
from . import intervals
from .intervals import Interval

_WALLS, _SPOT = "wall_avoidance", "spot_finding"
PAPER: Mapping[Condition, Summary] = MappingProxyType(
    {
        Condition(_WALLS, "fixed"): Summary((260, 12, 13, 19, 196), 0.8232, 0.4959, 0.0584),
        Condition(_WALLS, "random"): Summary((196, 215, 1, 51, 37), 0.7150, 0.5137, 0.0160),
        Condition(_WALLS, "creative"): Summary((282, 65, 0, 80, 73), 0.6109, 0.7068, 0.0402),
        Condition(_SPOT, "fixed"): Summary((22, 2, 1, 20, 455), 0.0800, 0.9681, 0.0440),
        Condition(_SPOT, "random"): Summary((20, 16, 0, 323, 141), -0.8064, 0.5631, 0.0296),
        Condition(_SPOT, "creative"): Summary((109, 63, 1, 170, 157), 0.0045, 0.8829, 0.2581),
    }
)
"""The numbers of tables 1 and 2, 500 robots in each column."""


@dataclasses.dataclass(frozen=True)
class Column:
    """A column of table 1 or 2 with the 95 % intervals of its cells."""

    summary: Summary  # values of the cells
    shares: tuple[Interval, ...]  # of the robots in each category
    mean: Interval  # of L
    deviation: Interval  # standard deviation of L
    post_share: Interval  # mean share of the test after training in contact (or in the spot)


def column(run: Run, condition: Condition) -> Column:
    """Returns the column of a run's condition, computed from its robots."""
    abilities, summary = run.abilities(condition), run.summary(condition)
    measured = abilities[~np.isnan(abilities)]
    return Column(
        summary,
        _shares(summary),
        intervals.mean(measured, intervals.ABILITY),
        intervals.deviation(measured),
        intervals.mean(run.shares(condition, "post"), intervals.SHARE),
    )


def paper_column(condition: Condition) -> Column | None:
    """Returns the paper's column; None for an agent or a life that the paper does not have."""
    summary = PAPER.get(condition)
    if summary is None:
        return None
    unknown = intervals.UNKNOWN  # the paper does not print the scatter of single robots
    return Column(summary, _shares(summary), intervals.mean_from(summary), unknown, unknown)


def row_names(life: Life) -> list[str]:
    """Returns the names of a table's rows: robots, classes, mean and deviation of L, time."""
    names = [f"({life.unmeasured})" if c == "unmeasured" else c for c in CATEGORIES]
    return ["robots", *names, "mean L", "sd of L", f"share of time {life.event}, post"]


def _shares(summary: Summary) -> tuple[Interval, ...]:
    return tuple(intervals.share(count, summary.robots) for count in summary.counts)
