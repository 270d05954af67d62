"""Does creativity pay? Creative robots against random ones, in the runs that have both.

    python -m musebot.protocols.creativity RUN [RUN ...]

prints, for each run, by how much robots whose ideas come from the creative memory do better
than robots of the same evaluation network whose ideas are uniformly random.
"""

from __future__ import annotations

import dataclasses
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

import tyro

from . import engine, tables
from .beside import Cell, Side, compare, corrected, difference, names_of, number, resamples_for
from .errors import InputError, exit_status
from .experiment import TASKS
from .progress import bar
from .schedules import SCHEDULES

_MUSE, _CHANCE = "creative", "random"


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
    cells: tuple[Cell, ...]

    @property
    def robots(self) -> tuple[int, int]:
        """How many, creative and random."""
        creative, random = (len(self.side.results.of(self.task, p)) for p in (_MUSE, _CHANCE))
        return creative, random


def contests(sides: Sequence[Side]) -> list[Contest]:
    """All contests of runs, their p values corrected together.

    Raises:
      InputError: a run has no task with creative and random robots.
    """
    tasks = [
        [t for t in TASKS if {(t, _MUSE), (t, _CHANCE)} <= {*side.results.conditions()}]
        for side in sides
    ]
    for side, own in zip(sides, tasks, strict=True):
        if not own:
            raise InputError(f"{side.name} has no task with both creative and random robots")
    pairs = [(side, task) for side, own in zip(sides, tasks, strict=True) for task in own]
    family = 2 * len(pairs)
    cells: list[Cell] = []
    with bar() as progress:
        for side, task in progress.track(pairs, description="comparing"):
            both = (task, _MUSE), resamples_for(family), (task, _CHANCE)
            *_, ability, _, _, after = compare(side, side, *both)
            cells += [ability, after]
    found = iter(corrected(cells))
    return [Contest(side, task, (next(found), next(found))) for side, task in pairs]


def verdict(cell: Cell) -> str:
    """Whether creative robots are better or worse in a cell, or it is undecided."""
    if not cell.differs:
        return "undecided"
    good = cell.name == "mean L" or SCHEDULES[cell.task].wanted
    return "better" if (cell.difference > 0) == good else "worse"


def markdown(found: Sequence[Contest]) -> str:
    """A row a contest and cell: both values, the difference, the verdict."""
    head = ["run", "brain", "ideas", "robots", "", *(_MUSE, _CHANCE), "difference", "creative is"]
    rows = [head, ["---", "---", "---:", "---:", "---", *["---:"] * 3, "---"]]
    for contest in found:
        experiment = contest.side.experiment
        course = "" if experiment.course == "paper" else f", course: {experiment.course}"
        for cell in contest.cells:
            rows.append(
                [
                    contest.side.name + course,
                    experiment.brain_name,
                    str(experiment.brain.ideas),
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
    return "\n".join([*map(tables.line, rows), "", note])


def main(runs: Annotated[tuple[Path, ...], tyro.conf.Positional]) -> None:
    """Prints by how much creative robots do better than random ones.

    Args:
      runs: folders of runs with both, `musebot run RUN --proposer creative random`.
    """
    if not runs:
        raise InputError("at least one run is needed")
    sides = [Side(n, *engine.read_run(run)) for n, run in zip(names_of(runs), runs, strict=True)]
    print(markdown(contests(sides)))


if __name__ == "__main__":
    sys.exit(exit_status(lambda: tyro.cli(main)))
