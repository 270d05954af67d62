"""The page of all boards: tables, learning curves, and what each learner costs."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np

from ...controller.brains import BRAINS
from ..agents.names import MOVED, TRAINED_BEFORE, name_in_track
from ..analysis import intervals
from ..analysis.hypothesis_tests import ALPHA
from ..compare.agent_check import Costs
from ..pages import style
from ..pages.markdown import mean_cell, probability, table, with_interval
from .boards import DRAWS, Board, Entry, Ranking, first_learner
from .costs import Boards, Measured
from .study import Page
from .summary import placed, score_cell, summary

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from .tune import Effort

BOARDS_HEADING = "## Boards"
"""Title of the part of the page that follows the summary."""

_LINE_STYLES = ("-", "--")


def page(found: Boards, costs: Measured, efforts: Mapping[str, Effort]) -> Page:
    """Returns the page of all boards.

    Args:
      found: Learners and bounds of each board.
      costs: What learners cost, by board and name.
      efforts: Effort of tuning, by `name_in_track`.
    """
    places = {board: placed(board, entries) for board, entries in found.items()}
    parts, figures = [*summary(places), BOARDS_HEADING, ""], {}
    with style.styled():
        for board, (order, tests) in places.items():
            parts += markdown(board, order, tests, costs.get(board, {}), efforts)
            figures[board.name] = draw(order)
    return Page("\n".join(parts), figures)


def markdown(
    board: Board,
    ranking: Ranking,
    tests: np.ndarray,
    costs: Mapping[str, Costs],
    efforts: Mapping[str, Effort],
) -> list[str]:
    """Returns the tables of a board: a row for each learner.

    Args:
      board: What the learners are compared in.
      ranking: Learners and bounds, see `ranked`.
      tests: p of each pair, see `pair_tests`.
      costs: What each costs, by its name.
      efforts: Effort of tuning, by `name_in_track`.
    """
    result = _scores(ranking, tests) if board.ranks else _contacts(ranking)
    made = [["learner", "us", "ratio", "KiB", "tuned", "module", "`musebot run OUT` with"]]
    made += [
        [
            entry.name,
            *_costs(costs.get(entry.name)),
            _tuned(entry, efforts),
            f"`{module_of(entry.condition.proposer)}`",
            f"`{entry.command}`",
        ]
        for entry in (one.entry for one in ranking)
    ]
    return [
        f"### {board.title}",
        "",
        *result,
        "",
        *table(made),
        "",
        "us: time of a robot-step without the simulation, in microseconds; ratio: the same divided "
        "by that of the paper's creative brain, measured right after; KiB: a robot's in a "
        "checkpoint; a dash for `ppo` and for agents of third parties, which `musebot check-agent` "
        "measures. "
        "Tuned: settings that were tried, and the best of them again.",
        "",
    ]


def _scores(ranking: Ranking, tests: np.ndarray) -> list[str]:
    rows = [
        [
            "learner", "robots", "score", "in the spot after training", "during training",
            "worst tenth", "fail", "mean L", "p against the first",
        ]
    ]  # fmt: skip
    against_the_first = tests[first_learner(ranking)]
    for one, own in zip(ranking, against_the_first, strict=True):
        rows.append(
            [
                *_name(one.entry),
                score_cell(one),
                *_times(one.entry),
                f"{(one.scores < 0.5).mean():.0%}",
                _mean_ability(one.entry),
                "" if math.isnan(own) else probability(own),
            ]
        )
    return [
        *table(rows),
        "",
        "Score: mean of the time after training and of that during all of training, each 0 for "
        "the mean newborn and 1 for the mean hand-coded robot; interquartile mean over robots with "
        "its 95 % bootstrap interval, for which the robots of both bounds are drawn, too. Fail: "
        "share of robots with a score below 0.5. Mean L rewards bad newborns, so it does not rank. "
        f"p: bootstrap test of the difference of two scores, {_correction(ranking)}. "
        "Worst tenth: mean time in the spot after training of the tenth with the lowest. A robot "
        "that was stopped counts as the worst. In italics what is not compared: the bounds, and "
        "what was trained beforehand.",
        "",
        *standings(ranking, tests),
    ]


def _correction(ranking: Ranking) -> str:
    """Returns in words how p is corrected, and the smallest p that the number of draws allows."""
    words = "Holm over all pairs of learners"
    if pairs := math.comb(sum(one.entry.competes for one in ranking), 2):
        words += f"; {DRAWS:,} draws allow no p below {min(1.0, pairs * 2 / (DRAWS + 1)):.4f}"
    return words


def standings(ranking: Ranking, tests: np.ndarray) -> list[str]:
    """Returns in words which learners are above and below the creative robots and DQN.

    These comparisons decide the plan's verdicts.
    """
    lines = []
    for number, entry in enumerate(one.entry for one in ranking):
        if entry.condition.proposer != "creative" and entry.name != "dqn":
            continue
        significant = [n for n in range(len(ranking)) if tests[number, n] < ALPHA]
        above, below = (
            [ranking[n].entry.name for n in significant if (n < number) == better]
            for better in (True, False)
        )
        words = [
            f"{where} it: {'; '.join(names) if names else 'none'}"
            for where, names in (("above", above), ("below", below))
        ]
        lines.append(f"- {entry.name}: significantly {', '.join(words)}.")
    return lines


def _contacts(ranking: Ranking) -> list[str]:
    rows = [
        [
            "learner", "robots", "touch a wall", "without contact after training",
            "during training", "worst tenth", "mean L",
        ]
    ]  # fmt: skip
    entries = [one.entry for one in ranking]
    for entry in sorted(entries, key=lambda entry: entry.touching / len(entry.after)):
        share = intervals.share(entry.touching, len(entry.after))
        touching = with_interval(str(entry.touching), share, ".0%")
        rows.append([*_name(entry), touching, *_times(entry), _mean_ability(entry)])
    return [
        *table(rows),
        "",
        "Most learners are at the ceiling of this task: they are not ranked. Touch a wall: robots "
        "with any contact in the test after training, with Wilson's 95 % interval. A robot that "
        "was stopped counts as one. In italics the bounds, and what was trained beforehand.",
    ]


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


def _costs(found: Costs | None) -> list[str]:
    if found is None:
        return ["-", "-", "-"]
    ratio = found.microseconds / found.papers
    return [f"{found.microseconds:.1f}", f"{ratio:.1f}", f"{found.bytes / 1024:.1f}"]


def _tuned(entry: Entry, efforts: Mapping[str, Effort]) -> str:
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
    key = name_in_track(entry.condition.proposer, entry.experiment.signals)
    if key not in efforts:
        return "own settings" if settings else "defaults"
    effort = efforts[key]
    return effort.words if settings in effort.tried else "own settings, not those of the tuning"


def module_of(proposer: str) -> str:
    """Returns the module of an agent, or that of the three proposers' brain."""
    name = MOVED.get(proposer, proposer)
    return name.partition(":")[0] if ":" in name else "musebot.controller"


def draw(ranking: Ranking) -> Figure:
    """Draws the learning curve of each entry, ten minutes a point, named at its end."""
    figure, axes = style.canvas(3.2, 1, 1)
    axis = axes.flat[0]
    ends = {}
    for number, entry in enumerate(one.entry for one in ranking):
        width = min(10, len(entry.curve))  # a rehearsal may have fewer minutes
        whole = len(entry.curve) // width * width
        points = entry.curve[:whole].reshape(-1, width).mean(axis=1)
        hours = (np.arange(len(points)) + 1) * width / 60
        shade = style.PALETTE[number % len(style.PALETTE)]
        dashes = _LINE_STYLES[number // len(style.PALETTE) % len(_LINE_STYLES)]
        mark = "o" if len(points) == 1 else None
        axis.plot(hours, points, color=shade, linestyle=dashes, linewidth=1.2, marker=mark)
        ends[entry.name] = (float(points[-1]), shade)
    axis.set(xlabel="hours of training", ylabel="share of time", ylim=(-0.02, 1.02))
    style.label_ends(axis, float(axis.lines[0].get_xdata()[-1]), ends)
    return figure
