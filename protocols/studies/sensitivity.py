"""What the paper leaves open, chosen otherwise, one choice at a time, in the kinematic stand-in.

    python -m musebot.protocols.sensitivity OUT --robots 100 --processes 2

lives a baseline, the same with another seed, and every choice, each as a run in a folder of OUT,
and writes `OUT/sensitivity.md`. The same command goes on where it was stopped.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from ...controller import PROPOSERS, Parameters
from ...models import Kinematics
from ..analysis import comparison as beside
from ..analysis.comparison import Cell, Side
from ..errors import InputError, run_module
from ..experiment.experiment import TASKS, Experiment, Plan, default_cohort_size
from ..experiment.schedules import NAMES
from ..options import HERE, Out, WorkersTold
from ..reporting import tables
from ..terminal import bar
from . import variants as series

TABLE = "sensitivity.md"
BASELINE, NOISE = "baseline", "another-seed"


@dataclasses.dataclass(frozen=True)
class Choice:
    """A run that differs from the baseline in one choice.

    Attributes:
      name: of its folder.
      says: what is chosen, in words.
      fields: of the experiment, other than the baseline's.
      tasks: in which it can matter; in the others lives would be the baseline's, to the bit.
      proposers: likewise.
    """

    name: str
    says: str
    fields: Mapping[str, Any]
    tasks: tuple[str, ...] = TASKS
    proposers: tuple[str, ...] = PROPOSERS

    @property
    def conditions(self) -> list[tuple[str, str]]:
        """Where it can matter, in the tables' order."""
        return [(task, proposer) for task in self.tasks for proposer in self.proposers]

    def experiment(self, baseline: Experiment) -> Experiment:
        """The baseline, with this one choice made otherwise."""
        return dataclasses.replace(baseline, **self.fields)


_WALLS, _SPOTS = ("wall_avoidance",), ("spot_finding",)

CHOICES = (
    Choice(NOISE, "another seed, nothing else", {"seed": 2}),
    Choice("radius-20mm", "robot of radius 20 mm", {"kinematics": Kinematics(radius=0.02)}),
    Choice("radius-35mm", "robot of radius 35 mm", {"kinematics": Kinematics(radius=0.035)}),
    Choice("speed-125mm", "motor 0.5 is 0.125 m/s", {"motor_speed": 0.125}),
    Choice("speed-250mm", "motor 0.5 is 0.25 m/s", {"motor_speed": 0.25}),
    Choice(
        "wheel-base-55mm", "wheels a diameter apart", {"kinematics": Kinematics(wheel_base=0.055)}
    ),
    Choice("turned-45", "start turned by 45 degrees", {"turned_start": 45.0}),
    Choice("turned-180", "start turned by 180 degrees", {"turned_start": 180.0}),
    Choice("test-epsilon", "epsilon in the tests", {"brain": Parameters(test_epsilon=0.01)}),
    Choice("nose-printed", "Eq. 3 as printed", {"nose": "printed"}, tasks=_SPOTS),
    Choice(
        "across-placement",
        "learning across a placement",
        {"learn_across_placement": True},
        tasks=_WALLS,  # while learning in spot finding, no robot is placed
    ),
    Choice(
        "noise-on-biases",
        "noise on biases",
        {"brain": Parameters(noise_on_biases=True)},
        proposers=("creative",),
    ),
    Choice(
        "felt-pushed",
        "a wall felt only while pushed",
        {"kinematics": Kinematics(felt="pushed")},
        tasks=_WALLS,  # nothing feels walls in spot finding
    ),
    Choice(
        "any-contact",
        "contact felt at any instant of a control step",
        {"kinematics": Kinematics(any_contact=True)},
        tasks=_WALLS,
    ),
    Choice("slides", "a robot slides along a wall", {"kinematics": Kinematics(wall="slides")}),
    Choice("sticks", "a robot sticks to a wall", {"kinematics": Kinematics(wall="sticks")}),
    Choice("lag-80ms", "wheels lag as the body's do", {"kinematics": Kinematics(lag=0.08)}),
)


def plans(robots: int, time_scale: float) -> dict[str, Plan]:
    """Which lives are wanted, by the name of their folder, the baseline's first.

    Raises:
      InputError: a number makes no sense.
    """
    if robots < 1:
        raise InputError(f"the number of robots must be at least 1, got {robots}")
    baseline = Experiment(
        body="kinematic", cohort_size=default_cohort_size(robots), time_scale=time_scale
    )
    everywhere = [(task, proposer) for task in TASKS for proposer in PROPOSERS]
    wanted = {BASELINE: Plan.of(baseline, everywhere, robots)}
    for choice in CHOICES:
        experiment = choice.experiment(baseline)
        wanted[choice.name] = Plan.of(experiment, choice.conditions, robots)
    return wanted


def judge(sides: Mapping[str, Side]) -> list[tuple[Choice, list[Cell]]]:
    """Every choice's cells against the baseline's, corrected over all of them."""
    family = beside.CELLS * sum(len(choice.conditions) for choice in CHOICES)
    cells: list[Cell] = []
    with bar() as progress:
        pairs = [(choice, condition) for choice in CHOICES for condition in choice.conditions]
        for choice, condition in progress.track(pairs, description="comparing"):
            sides_of = sides[choice.name], sides[BASELINE]
            cells += beside.compare(*sides_of, condition, beside.resamples_for(family))
    found = iter(beside.corrected(cells))
    return [
        (choice, [next(found) for _ in range(beside.CELLS * len(choice.conditions))])
        for choice in CHOICES
    ]


def markdown(sides: Mapping[str, Side], judged: Sequence[tuple[Choice, list[Cell]]]) -> str:
    """Which cells each choice moves, and the noise of two seeds, as Markdown."""
    baseline = sides[BASELINE]
    found = {choice.name: cells for choice, cells in judged}
    noise = {_place(cell): cell for cell in found[NOISE]}
    moved = [(choice, cell) for choice, cells in judged for cell in cells if cell.differs]
    robots = max(len(baseline.results.of(*each)) for each in baseline.results.conditions())
    lines = ["### What each choice moves", ""]
    lines += [f"In the kinematic stand-in, {robots} robots a condition. {_verdict(judged)}", ""]
    if moved:
        head = ["choice", "task", "proposer", "cell", "chosen", BASELINE, "difference", "Holm"]
        rows = [[*head, "two seeds"], ["---"] * 4 + ["---:"] * 5]
        for choice, cell in moved:
            values = [beside.number(cell, value) for value in (cell.ours, cell.other)]
            values += [beside.difference(cell), beside.probability(cell.corrected)]
            values.append(beside.difference(noise[_place(cell)]))
            rows.append([choice.says, NAMES[cell.task], cell.proposer, cell.name, *values])
        lines += [*map(tables.line, rows), ""]
    lines += ["### The noise: two baselines of different seeds", ""]
    for task in TASKS:
        own = [cell for cell in noise.values() if cell.task == task]
        lines += [f"**{tables.title(task, baseline.experiment)}**", ""]
        lines += [*beside.table("another seed", "baseline", own), ""]
    return "\n".join([*lines, beside.note([cell for cells in found.values() for cell in cells])])


def _verdict(judged: Sequence[tuple[Choice, list[Cell]]]) -> str:
    every = [cell for _, cells in judged for cell in cells]
    quiet = [
        f"{choice.says} (in {len(choice.conditions)} conditions)"
        for choice, cells in judged
        if not any(cell.differs for cell in cells)
    ]
    moved = f"{sum(cell.differs for cell in every)} of {len(every)} cells differ"
    none = f" No cell does with: {'; '.join(quiet)}." if quiet else ""
    return (
        f"After Holm's correction {moved} from the baseline's.{none} Difference: chosen minus "
        "baseline; two seeds: another seed minus baseline, whose robots were born with other "
        "brains and are no pairs."
    )


def _place(cell: Cell) -> tuple[str, str, str]:
    return cell.task, cell.proposer, cell.name


def report(out: Path) -> str:
    """The page that a finished study comes to, as Markdown; changes nothing.

    Raises:
      InputError: a run is missing or damaged.
    """
    sides = series.read(out, [BASELINE, *(choice.name for choice in CHOICES)])
    return markdown(sides, judge(sides))


def main(
    out: Out,
    robots: int = 100,
    time_scale: float = 1.0,
    workers: WorkersTold = HERE,
) -> None:
    """Lives what the paper leaves open, chosen otherwise, in the kinematic stand-in.

    Args:
      out: folder of the runs, a folder each, and of sensitivity.md; an unfinished one goes on.
      robots: in each condition.
      time_scale: below 1 shortens every duration, for rehearsals.
      workers: who lives them.
    """
    series.conduct(out, plans(robots, time_scale), workers, TABLE, report)


if __name__ == "__main__":
    run_module(main)
