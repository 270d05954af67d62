"""The summary of all boards: for each track and simulator a row a learner, a column a board."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np

from ...reporting.markdown import table, with_interval
from .boards import (
    LOWER,
    SATURATED,
    UPPER,
    Board,
    Entry,
    Ranking,
    behind_the_first,
    interquartile_mean,
)

_LEVEL = 0.05

Placed = tuple[Ranking, Sequence[float]]
"""A board's learners, the best first, and p of each against the first."""


def placed(board: Board, ranking: Ranking) -> Placed:
    """Returns the places of a board; p is NaN where nothing is ranked."""
    return ranking, behind_the_first(ranking) if board.ranks else [math.nan] * len(ranking)


def summary(found: Mapping[Board, Placed]) -> list[str]:
    """Returns a table for each track and simulator, as lines of Markdown."""
    groups: dict[str, dict[Board, Placed]] = {}
    for board, places in found.items():
        groups.setdefault(board.track, {})[board] = places
    return [line for track, own in groups.items() for line in (f"## {track}", "", *_table(own), "")]


def _table(found: Mapping[Board, Placed]) -> list[str]:
    boards = sorted(found, key=lambda board: not board.ranks)
    cells: dict[str, dict[Board, str]] = {}
    values: dict[str, list[float]] = {}
    for board in boards:
        for (entry, scores), p in zip(*found[board], strict=True):
            name = _name(entry)
            middle, interval = interquartile_mean(scores)
            if board.ranks:
                values.setdefault(name, []).append(middle)
                text = "-" if math.isnan(middle) else with_interval(f"{middle:.3f}", interval)
                among_the_first = not p < _LEVEL and entry.name not in (LOWER, UPPER)
                cell = f"**{text}**" if among_the_first else text
            else:
                cell = f"{(entry.after < 1).sum()} of {len(entry.after)}"
            cells.setdefault(name, {})[board] = cell
    order = sorted(cells, key=lambda name: (-_mean(values.get(name, [])), name))
    rows = [["learner", *(board.column for board in boards)]]
    rows += [
        [
            f"*{name}*" if name in (LOWER, UPPER) else name,
            *(cells[name].get(board, "-") for board in boards),
        ]
        for name in order
    ]
    return [
        *table(rows),
        "",
        "Score: 0 like the mean newborn, 1 like the mean hand-coded robot; bold: the first of a "
        "board and all that do not differ detectably from it (p of the tables below at least "
        f"{_LEVEL}). Touch a wall: robots with any contact in the test after training. In italics "
        "the bounds.",
    ]


def _name(entry: Entry) -> str:
    """Returns the name of a learner, the same in both tracks."""
    if not entry.condition.has_brain:
        return entry.name
    words = [word for word in entry.experiment.brain_name.split() if word not in SATURATED]
    return f"{' '.join(words)}, {entry.condition.proposer}"


def _mean(values: Sequence[float]) -> float:
    known = [value for value in values if not math.isnan(value)]
    return float(np.mean(known)) if known else -math.inf
