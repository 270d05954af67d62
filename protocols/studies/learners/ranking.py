"""The page of all boards: tables, learning curves, and what each learner costs."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from ...agents.agent_check import Costs
from ...agents.names import MOVED, is_own
from ...analysis import intervals
from ...reporting import style
from ...reporting.markdown import bracket, mean_cell, table
from ...results.run import Run
from ...storage import resolved
from ..study import Page
from .boards import LOWER, UPPER, Board, Entry, behind_the_first, boards, interquartile_mean, ranked
from .costs import CostJob

FOLDER = "costs"
_LINE_STYLES = ("-", "--")


def cost_jobs(out: Path, runs: Sequence[Run]) -> list[CostJob]:
    """Returns the jobs that measure what the learners of some runs cost; only our own agents."""
    jobs = (
        _cost_job(out, board, entry)
        for board, entries in boards(runs).items()
        for entry in entries
        if is_own(entry.condition.proposer)
    )
    return [*jobs]


def measured(out: Path, runs: Sequence[Run]) -> dict[tuple[Board, str], Costs]:
    """Returns what was measured of each learner, by its board and its name.

    Raises:
      DamagedFileError: a file is damaged, or another learner's.
    """
    jobs = {
        (board, entry.name): _cost_job(out, board, entry)
        for board, entries in boards(runs).items()
        for entry in entries
    }
    return {key: job.costs() for key, job in jobs.items() if job.done()}


def ranking(
    runs: Sequence[Run], costs: Mapping[tuple[Board, str], Costs], efforts: Mapping[str, str]
) -> Page:
    """Returns the page of all boards.

    Args:
      runs: Runs of the learners and of both bounds.
      costs: What learners cost, by board and name.
      efforts: Effort of tuning, by "agent, signals".

    Raises:
      InputError: see `boards`.
    """
    parts, figures = [], {}
    with style.styled():
        for board, entries in boards(runs).items():
            own = {name: one for (where, name), one in costs.items() if where == board}
            parts += markdown(board, entries, own, efforts)
            figures[board.name] = draw(entries)
    return Page("\n".join(parts), figures)


def _cost_job(out: Path, board: Board, entry: Entry) -> CostJob:
    name = f"{board.name}-{entry.name.replace(', ', '-').replace(' ', '-')}"
    return CostJob(
        resolved(out) / FOLDER / f"{name}.safetensors", entry.experiment, entry.condition
    )


def markdown(
    board: Board,
    entries: Sequence[Entry],
    costs: Mapping[str, Costs],
    efforts: Mapping[str, str],
) -> list[str]:
    """Returns the tables of a board: a row for each learner.

    Args:
      board: What the learners are compared in.
      entries: Learners and bounds.
      costs: What each costs, by its name.
      efforts: Effort of tuning, by "agent, signals".
    """
    ranking = ranked(entries)
    what = "in the spot" if board.task == "spot_finding" else "without contact"
    rows = [
        [
            "learner", "robots", "score", f"{what} after training", "during training",
            "worst tenth", "fail", "mean L", "p against the first",
        ]
    ]  # fmt: skip
    for (entry, values), p in zip(ranking, behind_the_first(ranking), strict=True):
        middle, interval = interquartile_mean(values)
        worst = np.sort(entry.after)[: math.ceil(len(entry.after) / 10)].mean()
        abilities = entry.abilities[~np.isnan(entry.abilities)]
        rows.append(
            [
                f"*{entry.name}*" if entry.name in (LOWER, UPPER) else entry.name,
                str(len(values)),
                "-" if math.isnan(middle) else f"{middle:.3f} {bracket(interval)}".strip(),
                mean_cell(entry.after, intervals.SHARE),
                mean_cell(entry.training, intervals.SHARE),
                f"{worst:.3f}",
                f"{(values < 0.5).mean():.0%}",
                f"{abilities.mean():.2f}" if len(abilities) else "-",
                "" if math.isnan(p) else f"{p:.4f}",
            ]
        )
    made = [["learner", "time", "KiB", "tuned", "module", "`musebot run OUT` with"]]
    made += [
        [
            entry.name,
            *_costs(costs.get(entry.name)),
            _tuned(entry, efforts),
            f"`{module_of(entry.condition.proposer)}`",
            f"`{entry.command}`",
        ]
        for entry, _ in ranking
    ]
    return [
        f"## {board.title}",
        "",
        *table(rows),
        "",
        "Score: mean of the time after training and of that during all of training, each 0 for "
        "the mean newborn and 1 for the mean hand-coded robot; interquartile mean over robots with "
        "its 95 % bootstrap interval. Fail: share of robots with a score below 0.5. p: permutation "
        "test of the mean score, Holm over all pairs of learners. In italics the bounds.",
        "",
        *table(made),
        "",
        "Time: of a robot-step without the simulation, as a multiple of the paper's creative "
        "brain's, measured right after; KiB: a robot's in a checkpoint. Tuned: settings that were "
        "tried for a quarter of the time, then in whole lives.",
        "",
    ]


def _costs(found: Costs | None) -> list[str]:
    if found is None:
        return ["-", "-"]
    return [f"{found.microseconds / found.papers:.1f}", f"{found.bytes / 1024:.1f}"]


def _tuned(entry: Entry, efforts: Mapping[str, str]) -> str:
    if entry.name in (LOWER, UPPER):
        return ""
    if entry.condition.has_brain:
        return "by hand" if entry.experiment.brain_name.startswith("steady") else "as published"
    key = f"{entry.condition.proposer}, {entry.experiment.signals}"
    return efforts.get(key, "defaults")


def module_of(proposer: str) -> str:
    """Returns the module of an agent, or that of the three proposers' brain."""
    name = MOVED.get(proposer, proposer)
    return name.partition(":")[0] if ":" in name else "musebot.controller"


def draw(entries: Sequence[Entry]) -> Figure:
    """Draws the learning curve of each entry, ten minutes a point, named at its end."""
    figure, axes = style.canvas(3.2, 1, 1)
    axis = axes.flat[0]
    ends = {}
    for number, (entry, _) in enumerate(ranked(entries)):
        whole = max(len(entry.curve) // 10 * 10, 1)
        width = min(10, whole)
        points = entry.curve[: whole // width * width].reshape(-1, width).mean(axis=1)
        hours = (np.arange(len(points)) + 1) * width / 60
        shade = style.PALETTE[number % len(style.PALETTE)]
        dashes = _LINE_STYLES[number // len(style.PALETTE) % len(_LINE_STYLES)]
        axis.plot(hours, points, color=shade, linestyle=dashes, linewidth=1.2)
        ends[entry.name] = (float(points[-1]), shade)
    axis.set(xlabel="hours of training", ylabel="share of time", ylim=(0, 1))
    style.label_ends(axis, float(axis.lines[0].get_xdata()[-1]), ends)
    return figure
