"""The page of the study: cells, contrasts, decisions, seats, and the figure of all ways."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.figure import Figure

from ...analysis import intervals
from ...analysis.hypothesis_tests import ALPHA, holm, same_share
from ...experiment.conditions import Condition
from ...experiment.schedules import SCHEDULES, TASK_NAMES
from ...reporting import style
from ...reporting.markdown import MEANS, mean_cell, probability, table, with_interval
from ...results.run import Run
from ..study import Page
from .answers import MARGIN, Answer, compared, contrasts, decisions, measured, rule
from .cells import IDEAS, WAYS, Cell, Part, PartName


@dataclasses.dataclass(frozen=True)
class Outcome:
    """What the robots of a cell did in a task.

    Attributes:
      cell: Cell of the robots.
      task: Task of the robots.
      shares: Each robot's share of the test after training with the event, shape (n,); NaN for a
        robot whose simulation became unstable.
    """

    cell: Cell
    task: str
    shares: np.ndarray

    @classmethod
    def of(cls, cell: Cell, run: Run, condition: Condition) -> Outcome:
        """Returns the outcome of a condition of a cell's run."""
        shares = np.full(len(run.robots(condition)), np.nan)
        shares[run.valid_rows(condition)] = run.shares(condition, "post")
        return cls(cell, condition.task, shares)

    @property
    def measured(self) -> np.ndarray:
        """Shares of the valid robots."""
        return measured(self.shares)


Seats = Mapping[tuple[Cell, Cell], np.ndarray]
"""Share of each brain's test, by the cells in which it was trained and in which it is tested."""


def page(name: PartName, part: Part, scale: str, outcomes: Sequence[Outcome], seats: Seats) -> Page:
    """Returns the page made from what is finished.

    Args:
      name: Name of the part.
      part: The part.
      scale: That durations are scaled, see `labels.durations`.
      outcomes: Finished cells.
      seats: Finished tests of brains under other ways.
    """
    done, cells = len({outcome.cell for outcome in outcomes}), len(part.cells)
    lines = [
        f"Ways to propose actions: {part.says}. Seed {part.seed}{scale}; {done} of {cells} cells "
        "are finished.",
        "",
    ]
    for task in part.tasks:
        own = [outcome for outcome in outcomes if outcome.task == task]
        if own:
            lines += _cells(task, own)
    spot = {one.cell: one.shares for one in outcomes if one.task == "spot_finding"}
    figures: dict[str, Figure] = {}
    if name == "first" and spot:
        lines += [*_contrasts(spot), *_seated(seats)]
        with style.styled():
            figures = {"proposers": draw(spot)}
    if name == "rule":
        lines += _rule(spot)
    if name == "context" and len(spot) == len(part.cells):
        lines += _never(spot)
    return Page("\n".join(lines), figures)


def _cells(task: str, outcomes: Sequence[Outcome]) -> list[str]:
    answers = compared({outcome.cell: outcome.shares for outcome in outcomes})
    rows = [
        ["way", "ideas", "outside ideas", "robots", "time after training", "from `connections`"]
        + ["p (Holm)"]
    ]
    for one in sorted(outcomes, key=lambda one: (one.cell.ideas, one.cell.outside)):
        answer = answers.get(one.cell)
        invalid = len(one.shares) - len(one.measured)
        rows.append(
            [
                f"`{one.cell.way}`",
                str(one.cell.ideas),
                "yes" if one.cell.outside else "no",
                str(len(one.measured)) + (f" ({invalid} invalid)" if invalid else ""),
                mean_cell(one.measured, intervals.SHARE) if len(one.measured) else "-",
                *(_difference(answer) if answer else ("", "")),
            ]
        )
    event = SCHEDULES[task].event
    return [
        f"### {TASK_NAMES[task]}",
        "",
        *table(rows),
        "",
        f"Share of the test after training {event}, mean over valid robots, 95 % interval "
        f"({MEANS}). Difference from today's way with equally many ideas and, where there are "
        "some, the same share of outside ideas; permutation test, in pairs of robots with the same "
        "newborn evaluation network (all ways but `uniform` and `recurrent`). Ways that do not "
        "depend on outside ideas, or on the number of ideas, were simulated once.",
        "",
    ]


def _difference(answer: Answer) -> tuple[str, str]:
    return with_interval(f"{answer.value:+.3f}", answer.interval), probability(answer.p)


def _contrasts(groups: Mapping[Cell, np.ndarray]) -> list[str]:
    answers = contrasts(groups)
    finished = {name: one for name, one in answers.items() if not math.isnan(one.value)}
    lines = []
    if finished:
        rows = [["contrast", "value", "p (Holm)"]]
        rows += [[name, *_difference(answer)] for name, answer in finished.items()]
        lines += [
            "### Contrasts",
            "",
            *table(rows),
            "",
            "Weighted sums of the cells' means (docs/plans/proposers.md), 95 % interval and p by "
            "Student's t test of the robots' own sums; Holm's correction over "
            f"{len(answers)} contrasts.",
            "",
        ]
    said = decisions(groups)
    return [*lines, *(f"- {sentence}" for sentence in said), *[""] * bool(said)]


def _seated(seats: Seats) -> list[str]:
    if not seats:
        return []
    ways = list(dict.fromkeys(cell.way for pair in seats for cell in pair))
    ways = [way for way in WAYS if way in ways]
    shares = {(trained.way, test.way): values for (trained, test), values in seats.items()}
    rows = [["trained with", *ways]]
    for trained in ways:
        cells = [shares.get((trained, test)) for test in ways]
        rows.append(
            [trained, *("-" if x is None else f"{float(np.nanmean(x)):.3f}" for x in cells)]
        )
    return [
        "### Learning against deciding",
        "",
        *table(rows),
        "",
        "Share of 20 minutes of the test after training in the spot, mean over the brains of a "
        f"cell's first cohort ({min(map(len, seats.values()))}); {max(IDEAS)} ideas, no outside "
        "ideas, weights frozen. Columns: way under which the brains are tested. A dash: the brains "
        "have no such memory. Under `untrained` every brain has the memory of another newborn.",
        "",
    ]


def _rule(groups: Mapping[Cell, np.ndarray]) -> list[str]:
    tests = rule(groups)
    if not tests:
        return []
    rows = [["test", "p"], *([one.words, probability(one.p_for)] for one in tests)]
    holds = all(one.p_for < ALPHA for one in tests)
    said = "is not worse" if holds else "is not shown to be not worse"
    return [
        "### The one-fifth rule",
        "",
        *table(rows),
        "",
        f"One-sided Welch tests that the rule is not worse by more than {MARGIN}. The rule {said} "
        "at all numbers of ideas.",
        "",
    ]


def _never(groups: Mapping[Cell, np.ndarray]) -> list[str]:
    """Returns the table of both tests of the context, corrected together."""
    (today, before), (recurrent, after) = groups.items()
    before, after = measured(before), measured(after)
    never = [shares == 0 for shares in (before, after)]
    time = compared(groups)[recurrent].p  # of one comparison, so not corrected
    p_values = holm(np.array([time, same_share(never[0], never[1], paired=False)]))
    counts = [f"{own.sum()} of {len(own)}" for own in never]
    rows = [
        ["", f"`{today.way}`", f"`{recurrent.way}`", "p (Holm)"],
        [
            "time in the spot",
            f"{before.mean():.3f}",
            f"{after.mean():.3f}",
            probability(p_values[0]),
        ],
        ["never in the spot after training", *counts, probability(p_values[1])],
    ]
    return [
        "### Recurrent context",
        "",
        *table(rows),
        "",
        "Permutation test and Fisher's exact test, corrected over both.",
        "",
    ]


def draw(groups: Mapping[Cell, np.ndarray]) -> Figure:
    """Draws the share of time against the number of ideas, a line for each way."""
    figure, axes = style.canvas(4.2, 1, 2, sharey=True)
    for axis, outside in zip(axes[0], (False, True), strict=True):
        ends = {}
        for number, way in enumerate(WAYS):
            known = [n for n in IDEAS if Cell(way, n, outside).simulated in groups]
            if not known or (outside and not WAYS[way].mixes):
                continue
            values = [measured(groups[Cell(way, n, outside).simulated]) for n in known]
            means = [float(own.mean()) for own in values]
            colour = style.PALETTE[number % len(style.PALETTE)]
            dashes = "-" if number < len(style.PALETTE) else "--"
            axis.plot(known, means, dashes, color=colour, marker="o", markersize=3)
            for ideas, own in zip(known, values, strict=True):
                axis.plot([ideas] * 2, intervals.mean(own, intervals.SHARE), color=colour, lw=0.7)
            ends[way] = means[-1], colour
        style.label_ends(axis, max(IDEAS), ends)
        axis.set_xscale("log")
        axis.set_xticks(IDEAS, [str(ideas) for ideas in IDEAS])
        axis.minorticks_off()
        axis.set(
            xlabel="ideas",
            xlim=(2.6, 110),
            title=f"{'With' if outside else 'Without'} outside ideas",
        )
    axes[0, 0].set_ylabel("time in the spot after training")
    axes[0, 0].set_ylim(-0.02, 1.02)
    style.in_per_cent(axes[0, 0].yaxis)
    return figure
