"""Does creativity pay? Creative robots against random ones, in the runs that have both.

    python -m musebot.protocols.creativity RUN [RUN ..] [--output FIGURE]

prints, for each run, by how much robots whose ideas come from the creative memory do better
than robots of the same evaluation network whose ideas are uniformly random; and what the best
idea of either kind lacks by the creative robots' own judgement. The figure shows the times.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated

import numpy as np
import torch
from matplotlib.figure import Figure

from ...controller.proposers import RandomActions
from ..analysis.comparison import (
    Cell,
    Match,
    Side,
    described,
    difference,
    names_of,
    number,
    outcomes,
    verdict,
)
from ..errors import InputError, run_module
from ..experiment.experiment import TASKS
from ..experiment.schedules import SCHEDULES
from ..options import Runs, option
from ..playback.stored_brains import stored_brains
from ..reporting import figures, tables
from ..reporting.robot_figures import lacking, situations
from ..simulation import engine

_MUSE, _CHANCE = "creative", "random"
_DRAWS = 20  # of ideas, each robot in each situation


@dataclasses.dataclass(frozen=True)
class Contest:
    """Creative against random robots of one task of a run.

    Attributes:
      side: the run.
      task: what they had to learn.
      cells: mean L, and the share of the time after training in contact or in the spot.
    """

    side: Side
    task: str
    cells: tuple[Cell, Cell]

    @property
    def robots(self) -> tuple[int, int]:
        """How many valid ones, creative and random."""
        creative, random = (
            len(self.side.results.valid(self.task, proposer)) for proposer in (_MUSE, _CHANCE)
        )
        return creative, random


def contests(sides: Sequence[Side]) -> list[Contest]:
    """All contests of runs, their p values corrected together.

    Raises:
      InputError: a run has no task with creative and random robots, or is a rehearsal.
    """
    tasks = [
        [t for t in TASKS if {(t, _MUSE), (t, _CHANCE)} <= {*side.results.conditions()}]
        for side in sides
    ]
    for side, own in zip(sides, tasks, strict=True):
        if not own:
            raise InputError(f"{side.name} has no task with both creative and random robots")
        if side.experiment.time_scale != 1:
            raise InputError(f"{side.name} is a rehearsal: what its robots learn tells nothing")
    pairs = [(side, task) for side, own in zip(sides, tasks, strict=True) for task in own]
    found = outcomes([Match(side, side, (task, _MUSE), (task, _CHANCE)) for side, task in pairs])
    return [Contest(*pair, cells) for pair, cells in zip(pairs, found, strict=True)]


def lacks(contest: Contest) -> dict[str, tuple[float, float]]:
    """What the best idea lacks by the judgement of the trained creative robots.

    Returns:
      By situation, `portraits.lacking` of their own ideas and of as many uniformly random ones,
      means over robots and draws of ideas; nothing where no life was valid.
    """
    experiment, results = contest.side.experiment, contest.side.results
    rows = [i for i, row in enumerate(results.of(contest.task, _MUSE)) if row.valid]
    if not rows:
        return {}
    after = [(row, "after") for row in rows]
    brain = stored_brains(experiment, results, contest.task, _MUSE, after, seed=0).controller
    chance = RandomActions(experiment.brain.ideas, torch.Generator().manual_seed(0))
    found = {}
    states = situations(experiment.batch(contest.task, 1), contest.task)
    for name, state in states.items():
        sensed = torch.from_numpy(state.astype(np.float32)).expand(len(rows), -1)
        own, random = (
            torch.stack([propose(sensed) for _ in range(_DRAWS)], dim=1)
            for propose in (brain.propose, chance.propose)
        )
        found[name] = tuple(lacking(brain, sensed, ideas).mean().item() for ideas in (own, random))
    return found


def markdown(found: Sequence[Contest], lacked: Sequence[Mapping[str, tuple[float, float]]]) -> str:
    """A row a contest and cell: both values, the difference, the verdict; and why.

    Args:
      found: the contests.
      lacked: of each, what ideas lack (`lacks`).
    """
    head = ["run", "ideas", "robots", "", *(_MUSE, _CHANCE), "difference", "creative is"]
    rows = [head, ["---", "---:", "---:", "---", *["---:"] * 3, "---"]]
    for contest in found:
        for cell in contest.cells:
            rows.append(
                [
                    contest.side.name,
                    str(contest.side.experiment.brain.ideas),
                    " and ".join(map(str, contest.robots)),
                    f"{contest.task}: {cell.name}",
                    number(cell, cell.ours),
                    number(cell, cell.other),
                    difference(cell),
                    verdict(cell),
                ]
            )
    note = (
        "Two independent groups of robots. In brackets the 95 % interval of the difference, BCa "
        "bootstrap. Better or worse: permutation test, corrected by Holm's method over the "
        f"{2 * len(found)} rows."
    )
    head = ["run", "ideas", "", "situation", "the best idea lacks", "the best random one"]
    why = [head, ["---", "---:", "---", "---", "---:", "---:"]]
    for contest, shares in zip(found, lacked, strict=True):
        ideas = str(contest.side.experiment.brain.ideas)
        for situation, (own, random) in shares.items():
            where = [contest.side.name, ideas, contest.task, situation]
            why.append([*where, f"{own:.1%}", f"{random:.1%}"])
    judged = (
        "By the judgement of the trained creative robots: how far the value of their best idea, or "
        "of the best of as many random ones, falls short of the best action's, as a share of the "
        "range of all actions' values."
    )
    whose = dict.fromkeys(described(c.side.name, c.side.experiment) for c in found)
    lines = [*map(tables.line, rows), "", note, "", *map(tables.line, why), "", judged, ""]
    return "\n".join([*lines, *whose])


def _words(contest: Contest) -> str:
    schedule, ideas = SCHEDULES[contest.task], contest.side.experiment.brain.ideas
    sense = "" if schedule.wanted else ": less is better"
    return f"{contest.side.name}, {ideas} ideas\n{schedule.event}{sense}"


def draw(found: Sequence[Contest]) -> Figure:
    """A row a contest: the time after training of both kinds, the difference, its interval."""
    figure, axes = figures.canvas(1.2 + 0.34 * len(found), 1, 2, sharey=True)
    both, apart = axes[0]
    for row, contest in enumerate(found):
        time = contest.cells[1]
        both.plot((time.ours, time.other), (row, row), color=figures.INK, linewidth=0.7)
        for value, kind in ((time.ours, _MUSE), (time.other, _CHANCE)):
            label = "_" + kind if row else kind  # in the key once
            both.plot(value, row, "o", color=figures.colour(kind), label=label)
        apart.plot(time.interval, (row, row), color=figures.INK)
        apart.plot(time.difference, row, "D", color=figures.INK, markersize=5)
    apart.axvline(0, color=figures.INK, linewidth=0.7, linestyle=":")
    both.set_yticks(range(len(found)), map(_words, found), fontsize=8)
    both.set(title="Share of the time", xlim=(0, 1))
    apart.set(title="Creative - random", ylim=(len(found) - 0.5, -0.5))
    for axis in axes[0]:
        figures.in_per_cent(axis.xaxis)
    figure.legend(*both.get_legend_handles_labels(), loc="outside lower center", ncols=2,
                  frameon=False, fontsize=8)  # fmt: skip
    return figure


def main(runs: Runs, output: Annotated[Path | None, option("FIGURE", "none")] = None) -> None:
    """Prints by how much creative robots do better than random ones.

    Args:
      runs: folders of runs with both, `musebot run RUN --proposer creative random`.
      output: a figure of their times after training, an .svg or .png.
    """
    if output:
        figures.check_output(output)
    if not runs:
        raise InputError("at least one run is needed")
    if len({run.resolve() for run in runs}) < len(runs):
        raise InputError("a run is given twice")
    sides = [
        Side(n, *engine.read_run(run, enact=True))
        for n, run in zip(names_of(runs), runs, strict=True)
    ]
    found = contests(sides)
    print(markdown(found, [lacks(contest) for contest in found]))
    if output:
        with figures.styled():
            figures.write(draw(found), output)


if __name__ == "__main__":
    run_module(main)
