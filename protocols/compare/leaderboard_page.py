"""The page of all boards: tables, learning curves, and what each learner costs."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np

from ...controller.brains import BRAINS
from ..agents.names import TRAINED_BEFORE
from ..analysis import intervals
from ..analysis.hypothesis_tests import ALPHA
from ..pages import style
from ..pages.markdown import mean_cell, probability, table, with_interval
from .boards import DRAWS, Board, Entry, Ranked, first_learner, pair_tests, ranked
from .study import Page

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from .tune import Tuning

Costs = Mapping[tuple[Board, str], np.ndarray]
"""What `benchmark.costs` measured of a learner, by board and name."""
Tunings = Mapping[tuple[str, str], "Tuning"]
"""Studies that tune, by recorded name and signals."""

_LINE_STYLES = ("-", "--")
_ABOUT = (
    "Score of a robot: the mean of its time in the spot after training and of that during all of "
    "training, each scaled so that the mean newborn has 0 and the mean hand-coded robot 1. Score "
    "of a learner: the interquartile mean over its robots (the newborns' own is therefore not "
    "exactly 0), with its 95 % bootstrap interval over its robots and those of both bounds. Rows "
    "are sorted by the first column, then by the next ones. Bold: the learner with the highest "
    "score of a board, and all that do not differ significantly from it (p at least "
    f"{ALPHA}, bootstrap tests of the difference of two scores, Holm over all pairs of a board's "
    f"learners, {DRAWS:,} draws); between few robots only large differences are significant. Touch "
    "a wall: robots with any contact in the test after training, of which most learners have none: "
    "they are not ranked. A robot that was stopped counts as the worst. In italics the bounds, and "
    "what was trained beforehand."
)
_COLUMNS = (
    "Fail: share of robots with a score below 0.5. Worst tenth: mean time after training of the "
    "tenth with the lowest. Mean L rewards bad newborns, so it does not rank. us: CPU time of a "
    "robot-step without the simulation, in microseconds; ratio: the same divided by that of the "
    "paper's creative brain, measured right after; KiB: a robot's in a checkpoint; a dash for what "
    "was trained beforehand and for agents of third parties. Tuned: settings that were tried, and "
    "the best of them again."
)


def page(found: Mapping[Board, Sequence[Entry]], costs: Costs, tunings: Tunings) -> Page:
    """Returns the page of all boards, with what their learners cost and how they were tuned."""
    rankings = {board: ranked(entries) for board, entries in found.items()}
    tests = {board: pair_tests(ranking) for board, ranking in rankings.items() if board.ranks}
    tracks: dict[str, list[Board]] = {}
    for board in rankings:
        tracks.setdefault(board.track, []).append(board)
    lines = []
    for track, own in tracks.items():
        rows = _summary({board: rankings[board] for board in own}, tests)
        lines += [f"## {track[0].upper()}{track[1:]}", "", *table(rows), ""]
    lines += [_ABOUT, "", "## Boards", "", _COLUMNS, ""]
    figures = {}
    with style.styled():
        for board, ranking in rankings.items():
            rows = _scores(ranking, tests[board]) if board.ranks else _contacts(ranking)
            made = [["learner", "us", "ratio", "KiB", "tuned", "`musebot run OUT` with"]]
            for entry in (one.entry for one in ranking):
                cost = _costs(costs.get((board, entry.name)))
                made.append([entry.name, *cost, _tuned(entry, tunings), f"`{entry.command}`"])
            world = f"Lives of the first: {ranking[0].entry.world or 'as by default'}."
            lines += [f"### {board.title}", "", *table(rows), "", *table(made), "", world, ""]
            figures[board.name] = draw(ranking)
    return Page("\n".join(lines), figures)


def _summary(
    rankings: Mapping[Board, Sequence[Ranked]], tests: Mapping[Board, np.ndarray]
) -> list[list[str]]:
    """Returns the table of a track: a row a learner, a column a board."""
    # Spot finding, which decides a track, is first.
    order = sorted(rankings, key=lambda b: (not b.ranks, b.task))
    cells: dict[str, dict[Board, str]] = {}
    scores: dict[str, dict[Board, float]] = {}
    for board in order:
        first = first_learner(rankings[board])
        for number, one in enumerate(rankings[board]):
            entry, text = one.entry, f"{one.entry.touching} of {len(one.entry.after)}"
            if board.ranks:
                text = _score(one)
                best = number == first or tests[board][first, number] >= ALPHA
                if entry.competes and best and not math.isnan(one.score):
                    text = f"**{text}**"
                scores.setdefault(entry.title, {})[board] = np.nan_to_num(one.score, nan=-math.inf)
            cells.setdefault(entry.title, {})[board] = text

    def place(title: str) -> tuple[list[float], str]:
        own = scores.get(title, {})
        return [-own.get(board, -math.inf) for board in order], title

    rows = (
        [title, *(cells[title].get(b, "-") for b in order)] for title in sorted(cells, key=place)
    )
    return [["learner", *(board.column for board in order)], *rows]


def _scores(ranking: Sequence[Ranked], tests: np.ndarray) -> list[list[str]]:
    """Returns the table of a board that ranks."""
    head = "learner,robots,score,in the spot after training,during training,worst tenth,fail,mean L"
    rows = [[*head.split(","), "p against the first"]]
    for one, p in zip(ranking, tests[first_learner(ranking)], strict=True):
        fail = f"{(one.scores < 0.5).mean():.0%}"
        cells = [_score(one), *_times(one.entry), fail, _mean_ability(one.entry)]
        rows.append([*_name(one.entry), *cells, "" if math.isnan(p) else probability(p)])
    return rows


def _contacts(ranking: Sequence[Ranked]) -> list[list[str]]:
    """Returns the table of a board of wall avoidance, fewest robots with contact first."""
    head = "learner,robots,touch a wall,without contact after training,during training,worst tenth"
    rows = [[*head.split(","), "mean L"]]
    entries = [one.entry for one in ranking]
    for entry in sorted(entries, key=lambda entry: entry.touching / len(entry.after)):
        share = intervals.share(entry.touching, len(entry.after))
        touching = with_interval(str(entry.touching), share, ".0%")
        rows.append([*_name(entry), touching, *_times(entry), _mean_ability(entry)])
    return rows


def _score(one: Ranked) -> str:
    return "-" if math.isnan(one.score) else with_interval(f"{one.score:.3f}", one.interval)


def _name(entry: Entry) -> list[str]:
    stopped = f" ({entry.stopped} stopped)" if entry.stopped else ""
    return [entry.title, f"{len(entry.after)}{stopped}"]


def _times(entry: Entry) -> list[str]:
    worst = np.sort(entry.after)[: math.ceil(len(entry.after) / 10)].mean()
    means = (mean_cell(values, intervals.SHARE) for values in (entry.after, entry.training))
    return [*means, f"{worst:.3f}"]


def _mean_ability(entry: Entry) -> str:
    abilities = entry.abilities[~np.isnan(entry.abilities)]
    return f"{abilities.mean():.2f}" if len(abilities) else "-"


def _costs(found: np.ndarray | None) -> list[str]:
    if found is None:
        return ["-", "-", "-"]
    microseconds, papers, size = found
    return [f"{microseconds:.1f}", f"{microseconds / papers:.1f}", f"{size / 1024:.1f}"]


def _tuned(entry: Entry, tunings: Tunings) -> str:
    if entry.is_bound:
        return ""
    if entry.condition.has_brain:
        brain = entry.experiment.brain
        if dataclasses.replace(brain, raw_signals=True, raw_reward=True) == BRAINS["steady"]:
            return "by hand, hundreds of settings"
        return "as published" if brain == BRAINS["paper"] else "another brain, see the command"
    if entry.name == TRAINED_BEFORE:
        return f"{len(entry.after)} policies, trained beforehand"
    settings = tuple(sorted(entry.experiment.settings))
    tuning = tunings.get((entry.condition.proposer, entry.experiment.signals))
    if tuning is None:
        return "own settings" if settings else "defaults"
    return tuning.study.effort if settings in tuning.tried else "own settings, not the tuning's"


def draw(ranking: Sequence[Ranked]) -> Figure:
    """Draws the learning curve of each entry, ten minutes a point."""
    figure, axes = style.canvas(3.2, 1, 1)
    axis = axes.flat[0]
    for number, entry in enumerate(one.entry for one in ranking):
        width = min(10, len(entry.curve))  # a rehearsal may have fewer minutes
        whole = len(entry.curve) // width * width
        points = entry.curve[:whole].reshape(-1, width).mean(axis=1)
        hours = (np.arange(len(points)) + 1) * width / 60
        shade = style.PALETTE[number % len(style.PALETTE)]
        dashes = _LINE_STYLES[number // len(style.PALETTE) % len(_LINE_STYLES)]
        mark = "o" if len(points) == 1 else None
        line = axis.plot(hours, points, color=shade, linestyle=dashes, linewidth=1.2, marker=mark)
        line[0].set_label(entry.name)
    axis.set(xlabel="hours of training", ylabel="share of time", ylim=(-0.02, 1.02))
    figure.legend(loc="outside lower center", ncols=4, frameon=False, fontsize=8)
    return figure
