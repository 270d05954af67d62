"""The page of an evolution: its course, what each parameter weighs, and the winner's new lives."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from scipy import stats

from ....models import Kinematics
from ...analysis import intervals
from ...experiment.conditions import Condition
from ...experiment.experiment import Experiment
from ...experiment.overrides import overrides_of
from ...experiment.schedules import TASK_NAMES, Schedule
from ...reporting import style
from ...reporting.markdown import MEANS, mean_cell, table, with_interval
from ..study import Page
from .space import NEWBORNS, RANGES

_BRAINS = {"start": "first brain", "winner": "winner", "best": "best of the last generation"}
_LEAST = 12  # evaluations from which the weight of a parameter is shown


@dataclasses.dataclass(frozen=True)
class Generation:
    """A finished generation of P brains with n parameters.

    Attributes:
      points: Coordinates of the brains, shape (P, n).
      fitness: Mean share of the test after training with the event, its negative where the event
        is unwanted, shape (P,).
      mean: Coordinates of the search's mean after the generation, shape (n,).
    """

    points: np.ndarray
    fitness: np.ndarray
    mean: np.ndarray


@dataclasses.dataclass
class Evolution:
    """What is finished of a search.

    Attributes:
      over: Names of the n parameters.
      generations: Finished generations.
      tests: Shares of the robots on fresh seeds, each of shape (B,), with the brains "start",
        "winner", and "best", that of the last generation; empty if missing.
      words: Options of `musebot run` that choose the winner's brain and its lives.
    """

    over: Sequence[str]
    generations: list[Generation] = dataclasses.field(default_factory=list)
    tests: Mapping[str, np.ndarray] = dataclasses.field(default_factory=dict)
    words: str = ""

    @property
    def best(self) -> tuple[str, float] | None:
        """The parameters of the best brain so far, in words, and its fitness; None without one."""
        if not self.generations:
            return None
        one = max(self.generations, key=lambda generation: generation.fitness.max())
        point = one.points[one.fitness.argmax()]
        return self.described(point), float(one.fitness.max())

    def described(self, point: np.ndarray) -> str:
        """Returns the values at a point in words."""
        values = (RANGES[name].value(float(x)) for name, x in zip(self.over, point, strict=True))
        return ", ".join(f"{n}={value:.3g}" for n, value in zip(self.over, values, strict=True))

    def weights(self) -> list[tuple[str, float]]:
        """Returns of each parameter its correlation with the fitness.

        The correlation (Spearman) is of coordinates and fitness within generations, since seeds and
        mean differ between generations. There is no p: the search draws its points depending on
        what it has seen. Empty with fewer than 12 evaluations.
        """
        if sum(len(one.fitness) for one in self.generations) < _LEAST:
            return []
        points = np.concatenate([one.points - one.points.mean(axis=0) for one in self.generations])
        fitness = np.concatenate([one.fitness - one.fitness.mean() for one in self.generations])
        if np.ptp(fitness) == 0:
            return []
        found: list[Any] = [stats.spearmanr(column, fitness) for column in points.T]
        return [(name, float(one.statistic)) for name, one in zip(self.over, found, strict=True)]


def page(
    evolution: Evolution, experiment: Experiment, condition: Condition, schedule: Schedule
) -> Page:
    """Returns the page of what is finished.

    Args:
      evolution: The search.
      experiment: Experiment of the first brain.
      condition: Condition of the robots.
      schedule: Schedule of their lives.
    """
    if not evolution.generations:
        return Page("No generation is finished yet.\n")
    size = len(evolution.generations[0].fitness)
    sign = 1 if schedule.wanted else -1
    lines = [
        f"### {TASK_NAMES[condition.task]}: {schedule.event} after training",
        "",
        f"{len(evolution.generations)} generations of {size} brains, each with "
        f"{experiment.cohort_size} creative robots, started from `{experiment.brain_name}`; "
        f"protocol `{experiment.protocol}`, all durations times {experiment.time_scale:g}, "
        f"kinematic simulator {' '.join(overrides_of(experiment.kinematics, Kinematics()))}. A "
        f"generation's brains share their seed, the first {experiment.seed}; each generation has "
        "the next one.",
        "",
    ]
    rows = [["generation", "best", "mean", "worst", "mean of the search after it"]]
    for number, one in enumerate(evolution.generations, start=1):
        shares = np.sort(sign * one.fitness)[::-sign]
        cells = [f"{x:.3f}" for x in (shares[0], shares.mean(), shares[-1])]
        rows.append([str(number), *cells, evolution.described(one.mean)])
    lines += [*table(rows, "rrrrl"), ""]
    if weights := evolution.weights():
        rows = [["parameter", "correlation with the fitness", "spread at last"]]
        spread = evolution.generations[-1].points.std(axis=0)
        for (name, correlation), width in zip(weights, spread, strict=True):
            rows.append([f"`{name}`", f"{correlation:+.2f}", f"{width:.2f}"])
        lines += [
            "Spearman's correlation within generations. A search that has settled varies a "
            "parameter little, so a small correlation does not say that it has no effect; and "
            "parameters that it varies together share theirs. The end value of a parameter without "
            "effect is chance. "
            "*Spread*: standard deviation in the last generation, as a share of the range.",
            "",
            *table(rows),
            "",
        ]
    if evolution.tests:
        start, winner = evolution.tests["start"], evolution.tests["winner"]
        paired = NEWBORNS.isdisjoint(evolution.over)
        gain = intervals.difference_of_means(winner, start, paired=paired, span=intervals.SHARE)
        of = "of pairs of equal newborns" if paired else "of independent groups"
        rows = [["on fresh seeds", "robots", schedule.event]]
        for name, shares in evolution.tests.items():
            rows.append([_BRAINS[name], str(len(shares)), mean_cell(shares, intervals.SHARE)])
        change = winner.mean() - start.mean()
        seen = sign * float(evolution.generations[-1].fitness.max())
        lines += [
            *table(rows),
            "",
            f"Difference of winner and first brain, {of}: {with_interval(f'{change:+.3f}', gain)}. "
            f"The best brain of the last generation had {seen:.3f} on its own seed. The winner is "
            f"the mean of the search: `{evolution.words}`. In brackets 95 % intervals ({MEANS}).",
            "",
        ]
    with style.styled():
        figure = draw(evolution, sign, schedule.event)
    return Page("\n".join(lines), {"evolve": figure})


def draw(evolution: Evolution, sign: int, event: str) -> Figure:
    """Draws the fitness of every brain, and the mean of the search in each coordinate."""
    figure, axes = style.canvas(5.4, 2, 1, sharex=True)
    above, below = axes[:, 0]
    for number, one in enumerate(evolution.generations, start=1):
        numbers = np.full(len(one.fitness), number)
        above.plot(numbers, sign * one.fitness, "o", ms=2.8, color=style.INK, alpha=0.6)
    count = np.arange(1, len(evolution.generations) + 1)
    means = [sign * one.fitness.mean() for one in evolution.generations]
    above.plot(count, means, color=style.PALETTE[2])
    for name, shade in (("start", style.INK), ("winner", style.PALETTE[1])):
        if name in evolution.tests:
            shares, words = evolution.tests[name], f"{_BRAINS[name]},\nfresh seeds"
            above.axhline(shares.mean(), color=shade, lw=1, ls="--")
            above.annotate(
                words, (1, shares.mean()), xycoords=("axes fraction", "data"), xytext=(4, 0),
                textcoords="offset points", va="center", fontsize=7.5, color=shade,
                annotation_clip=False,
            )  # fmt: skip
    above.set_title(f"{event} after training: each brain, and the mean")
    style.in_per_cent(above.yaxis)
    path = np.array([one.mean for one in evolution.generations])
    ends = {}
    for index, name in enumerate(evolution.over):
        turn, place = divmod(index, len(style.PALETTE))
        below.plot(count, path[:, index], "--" if turn else "-", color=style.PALETTE[place])
        ends[name] = path[-1, index], style.PALETTE[place]
    style.label_ends(below, count[-1], ends, gap=0.07)
    below.set(ylim=(-0.03, 1.03), xlabel="generation")
    below.xaxis.get_major_locator().set_params(integer=True)
    below.set_title("mean of the search, from 0 to 1 of each range")
    return figure
