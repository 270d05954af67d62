"""The study of whether creativity helps: creative robots compared with random ones."""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import ClassVar

import numpy as np
import torch
from matplotlib.figure import Figure

from ...controller import RandomActions
from ..analysis.comparison import Cell, Match, outcomes, verdict
from ..analysis.hypothesis_tests import ALPHA
from ..analysis.regret import regret, situations
from ..errors import InputError
from ..experiment.conditions import Condition
from ..experiment.experiment import Experiment
from ..experiment.schedules import SCHEDULES
from ..playback.stored_brains import stored_brains
from ..reporting import style
from ..reporting.comparison_tables import difference, number
from ..reporting.labels import described
from ..reporting.markdown import MEANS, probability, table
from ..results.run import Run
from ..results.run_files import read_runs
from ..shared_options import Runs
from .study import Page, Study

_CREATIVE, _RANDOM = "creative", "random"
_DRAWS = 20  # of the ideas of each robot in each situation


@dataclasses.dataclass
class Creativity(Study):
    """Compare creative with random robots in runs that have both.

    Random robots have the same evaluation network, but their ideas are uniformly random. The page
    also reports the regret of both kinds of ideas, by the creative robots' evaluation networks.
    """

    name: ClassVar[str] = "creativity"

    runs: Runs
    """folders of finished runs of `musebot run RUN --proposer creative random`"""

    @functools.cached_property
    def _read(self) -> list[Run]:
        return read_runs(self.runs, replay=True)

    def experiments(self) -> Mapping[str, Experiment]:
        """See `Study.experiments`."""
        check_runs(self._read)
        return {run.name: run.experiment for run in self._read}

    def page(self, out: Path) -> Page:
        """See `Study.page`."""
        del out
        found = contrasts(self._read)
        text = markdown(found, [regrets(contrast) for contrast in found])
        with style.styled():
            return Page(text, {self.name: draw(found)})


@dataclasses.dataclass(frozen=True)
class Contrast:
    """Comparison of the creative with the random robots of a run in one task.

    Attributes:
      run: Run that has both kinds of robots.
      task: Task that the robots learned.
      cells: Two compared cells: mean L, and the share of time in contact (or in the spot) in the
        test after training.
    """

    run: Run
    task: str
    cells: tuple[Cell, Cell]

    @property
    def robots(self) -> tuple[int, int]:
        """Number of valid creative robots, and number of valid random robots."""
        creative, random = (
            len(self.run.valid(Condition(self.task, proposer))) for proposer in (_CREATIVE, _RANDOM)
        )
        return creative, random


def check_runs(runs: Sequence[Run]) -> None:
    """Raises InputError if a run has no task with both kinds of robots, or scaled durations."""
    for run in runs:
        if not _tasks(run):
            raise InputError(f"{run.name} has no task with both creative and random robots")
        if run.experiment.time_scale != 1:
            raise InputError(
                f"{run.name} is a rehearsal with scaled durations, which says nothing about "
                "creativity"
            )


def contrasts(runs: Sequence[Run]) -> list[Contrast]:
    """Returns all contrasts of several runs, with their p-values corrected together.

    Raises:
      InputError: see `check_runs`.
    """
    check_runs(runs)
    pairs = [(run, task) for run in runs for task in _tasks(run)]
    found = outcomes(
        [Match(run, run, Condition(task, _CREATIVE), Condition(task, _RANDOM))
         for run, task in pairs]
    )  # fmt: skip
    return [Contrast(*pair, cells) for pair, cells in zip(pairs, found, strict=True)]


def _tasks(run: Run) -> list[str]:
    return [task for task in run.tasks() if {_CREATIVE, _RANDOM} <= {*run.proposers(task)}]


def regrets(contrast: Contrast) -> dict[str, tuple[float, float]]:
    """Returns the regret of ideas, by the trained creative robots' evaluation networks.

    Returns:
      Two regrets (`analysis.regret`) by name of the situation: of the robots' own ideas, and of
      equally many uniformly random ideas. Each is a mean over robots and draws. Empty if there are
      no valid robots.
    """
    run, condition = contrast.run, Condition(contrast.task, _CREATIVE)
    rows = run.valid_rows(condition)
    if not rows:
        return {}
    brain = stored_brains(run, condition, [(row, "after") for row in rows], seed=0).controller
    chance = RandomActions(run.experiment.brain.ideas, torch.Generator().manual_seed(0))
    found = {}
    states = situations(run.experiment.batch(contrast.task, 1), contrast.task)
    for name, state in states.items():
        sensed = torch.from_numpy(state.astype(np.float32)).expand(len(rows), -1)
        own, random = (
            torch.stack([propose(sensed) for _ in range(_DRAWS)], dim=1)
            for propose in (brain.propose, chance.propose)
        )
        found[name] = tuple(regret(brain, sensed, ideas).mean().item() for ideas in (own, random))
    return found


def markdown(
    found: Sequence[Contrast], regretted: Sequence[Mapping[str, tuple[float, float]]]
) -> str:
    """Returns the page: a row for each contrast and cell, and the regret of ideas.

    Args:
      found: Comparisons to report.
      regretted: Regret of ideas for each comparison (`regrets`).
    """
    head = ["run", "ideas", "robots", "", _CREATIVE, _RANDOM, "difference", "p (Holm)"]
    rows = [[*head, "creative is"]]
    for contrast in found:
        for cell in contrast.cells:
            rows.append(
                [
                    contrast.run.name,
                    str(contrast.run.experiment.brain.ideas),
                    " and ".join(map(str, contrast.robots)),
                    f"{contrast.task}: {cell.name}",
                    number(cell, cell.ours),
                    number(cell, cell.other),
                    difference(cell),
                    probability(cell.corrected),
                    verdict(cell),
                ]
            )
    note = (
        "Two independent groups of robots. In brackets the 95 % interval of the difference "
        f"({MEANS}). p: permutation test, corrected by Holm's method over the "
        f"{2 * len(found)} rows; better or worse: p below {ALPHA:g}."
    )
    head = ["run", "ideas", "", "situation", "regret of their ideas", "of random ideas"]
    reasons = [head]
    for contrast, shares in zip(found, regretted, strict=True):
        ideas = str(contrast.run.experiment.brain.ideas)
        for situation, (own, random) in shares.items():
            where = [contrast.run.name, ideas, contrast.task, situation]
            reasons.append([*where, f"{own:.1%}", f"{random:.1%}"])
    explained = (
        "Regret: value of the best action minus value of the best idea, as a share of the range of "
        "all actions' values, by the evaluation networks of the trained creative robots. Compared "
        "are their own ideas and as many uniformly random ones."
    )
    descriptions = dict.fromkeys(described(contrast.run) for contrast in found)
    lines = [*table(rows, "lrrlrrrrl"), "", note, ""]
    lines += [*table(reasons, "lrllrr"), "", explained, ""]
    return "\n".join([*lines, *descriptions, ""])


def draw(found: Sequence[Contrast]) -> Figure:
    """Draws a row for each contrast: time after training of both kinds, and the difference."""
    figure, axes = style.canvas(1.2 + 0.34 * len(found), 1, 2, sharey=True)
    both, apart = axes[0]
    for row, contrast in enumerate(found):
        time = contrast.cells[1]
        both.plot((time.ours, time.other), (row, row), color=style.INK, linewidth=0.7)
        for value, kind in ((time.ours, _CREATIVE), (time.other, _RANDOM)):
            label = "_" + kind if row else kind  # in the legend once
            both.plot(value, row, "o", color=style.colour(kind), label=label)
        apart.plot(time.interval, (row, row), color=style.INK)
        apart.plot(time.difference, row, "D", color=style.INK, markersize=5)
    apart.axvline(0, color=style.INK, linewidth=0.7, linestyle=":")
    both.set_yticks(range(len(found)), map(_label, found), fontsize=8)
    both.set(title="Share of the time", xlim=(0, 1))
    apart.set(title="Creative - random", ylim=(len(found) - 0.5, -0.5))
    for axis in axes[0]:
        style.in_per_cent(axis.xaxis)
    figure.legend(*both.get_legend_handles_labels(), loc="outside lower center", ncols=2,
                  frameon=False, fontsize=8)  # fmt: skip
    return figure


def _label(contrast: Contrast) -> str:
    schedule, ideas = SCHEDULES[contrast.task], contrast.run.experiment.brain.ideas
    sense = "" if schedule.wanted else ": less is better"
    return f"{contrast.run.name}, {ideas} ideas\n{schedule.event}{sense}"
