"""The summary of all boards: for each track and simulator a row a learner, a column a board."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np

from ..analysis.hypothesis_tests import ALPHA
from ..pages.markdown import table, with_interval
from .boards import Board, Entry, Ranked, Ranking, first_learner, pair_tests, ranked

Placed = tuple[Ranking, np.ndarray]
"""A board's learners, the best first, and p of each pair, see `pair_tests`."""


def score_cell(one: Ranked) -> str:
    """Returns a score with its interval, as a cell; a dash where there is none."""
    return "-" if math.isnan(one.score) else with_interval(f"{one.score:.3f}", one.interval)


def placed(board: Board, entries: Sequence[Entry]) -> Placed:
    """Returns the places of a board; p is NaN where nothing is ranked."""
    ranking = ranked(entries, draw=board.ranks)
    unranked = np.full((len(ranking), len(ranking)), math.nan)
    return ranking, pair_tests(ranking) if board.ranks else unranked


def summary(found: Mapping[Board, Placed]) -> list[str]:
    """Returns a table for each track and simulator, as lines of Markdown."""
    groups: dict[str, dict[Board, Placed]] = {}
    for board, places in found.items():
        groups.setdefault(board.track, {})[board] = places
    lines = []
    for track, own in groups.items():
        lines += [f"## {track[0].upper()}{track[1:]}", "", *table(_rows(own)), ""]
    return [
        *lines,
        "Score of a robot: the mean of its time in the spot after training and of that during "
        "training, each scaled so that the mean newborn has 0 and the mean hand-coded robot 1. "
        "Score of a learner: the interquartile mean over its robots (the newborns' own is "
        "therefore not exactly 0), with its 95 % interval over its robots and those of both "
        "bounds. Rows are sorted by the first column, then by the next ones. Bold: the learner "
        "with the highest score of a board, and all that do not differ significantly from it (p "
        f"at least {ALPHA}, for all pairs of a board); between few robots only large differences "
        "are significant. Touch a wall: robots with any contact in the test after "
        "training. In italics the bounds, and what was trained beforehand.",
        "",
    ]


def _rows(found: Mapping[Board, Placed]) -> list[list[str]]:
    boards = sorted(found, key=_column)
    titles: dict[str, str] = {}
    cells: dict[str, dict[Board, str]] = {}
    scores: dict[str, dict[Board, float]] = {}
    for board in boards:
        ranking, tests = found[board]
        first = first_learner(ranking)
        for number, one in enumerate(ranking):
            entry, text = one.entry, "-"
            if not board.ranks:
                text = f"{entry.touching} of {len(entry.after)}"
            elif not math.isnan(one.score):
                text = score_cell(one)
                if entry.competes:
                    best = number == first or tests[first, number] >= ALPHA
                    text = f"**{text}**" if best else text
                scores.setdefault(entry.name, {})[board] = one.score
            titles[entry.name] = entry.title
            cells.setdefault(entry.name, {})[board] = text

    # In wall avoidance nothing saturates: the paper's brain is in both tracks, but ranked in one.
    ranks = [board for board in boards if board.ranks]
    if ranks:
        cells = {name: own for name, own in cells.items() if own.keys() & ranks}

    def place(name: str) -> tuple[list[float], str]:
        own = scores.get(name, {})
        return [-own.get(board, -math.inf) for board in ranks], name

    return [
        ["learner", *(board.column for board in boards)],
        *(
            [titles[name], *(cells[name].get(board, "-") for board in boards)]
            for name in sorted(cells, key=place)
        ),
    ]


def _column(board: Board) -> tuple[bool, bool, float, str]:
    """Returns the place of a board's column: protocol `paper`, which decides a track, is first."""
    return not board.ranks, board.protocol != "paper", board.arena_scale, board.protocol
