"""The study of choices that the paper leaves open, each varied alone."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import ClassVar

from ...controller import Parameters
from ...models import Kinematics
from ..analysis.comparison import CELLS, Cell, Match, compare_all
from ..experiment.conditions import PAPER_TASKS
from ..experiment.experiment import Experiment
from ..experiment.plan import Variant, default_cohort_size
from ..experiment.schedules import TASK_NAMES
from ..reporting import comparison_tables
from ..reporting.labels import title
from ..reporting.markdown import probability, table
from ..results.run import Run
from .study import Page
from .variants import VariantStudy

BASELINE, NOISE = "baseline", "another-seed"

_WALLS, _SPOTS = ("wall_avoidance",), ("spot_finding",)

CHOICES = (
    Variant(NOISE, says="another seed, nothing else", fields={"seed": 2}),
    Variant(
        "radius-20mm", says="robot of radius 20 mm", fields={"kinematics": Kinematics(radius=0.02)}
    ),
    Variant(
        "radius-35mm", says="robot of radius 35 mm", fields={"kinematics": Kinematics(radius=0.035)}
    ),
    Variant("speed-125mm", says="motor 0.5 is 0.125 m/s", fields={"motor_speed": 0.125}),
    Variant("speed-250mm", says="motor 0.5 is 0.25 m/s", fields={"motor_speed": 0.25}),
    Variant(
        "wheel-base-55mm",
        says="wheels a diameter apart",
        fields={"kinematics": Kinematics(wheel_base=0.055)},
    ),
    Variant("turned-45", says="start turned by 45 degrees", fields={"turned_start": 45.0}),
    Variant("turned-180", says="start turned by 180 degrees", fields={"turned_start": 180.0}),
    Variant(
        "test-epsilon", says="epsilon in the tests", fields={"brain": Parameters(test_epsilon=0.01)}
    ),
    Variant("nose-printed", says="Eq. 3 as printed", fields={"nose": "printed"}, tasks=_SPOTS),
    Variant(
        "across-placement",
        says="learning across a placement",
        fields={"learn_across_placement": True},
        tasks=_WALLS,  # in spot finding no robot is placed while it learns
    ),
    Variant(
        "noise-on-biases",
        says="noise on biases",
        fields={"brain": Parameters(noise_on_biases=True)},
        proposers=("creative",),
    ),
    Variant(
        "felt-pushed",
        says="contact sensed only while the robot pushes",
        fields={"kinematics": Kinematics(felt="pushed")},
        tasks=_WALLS,  # robots do not sense contact in spot finding
    ),
    Variant(
        "any-contact",
        says="contact sensed at any instant of a control step",
        fields={"kinematics": Kinematics(any_contact=True)},
        tasks=_WALLS,
    ),
    Variant(
        "slides",
        says="a robot slides along a wall",
        fields={"kinematics": Kinematics(wall="slides")},
    ),
    Variant(
        "sticks", says="a robot sticks to a wall", fields={"kinematics": Kinematics(wall="sticks")}
    ),
    Variant(
        "lag-80ms",
        says="wheels lag as the MuJoCo body's do",
        fields={"kinematics": Kinematics(lag=0.08)},
    ),
)


@dataclasses.dataclass
class Sensitivity(VariantStudy):
    """Vary what the paper leaves open, one choice at a time, in the kinematic simulator.

    Simulates a baseline, the baseline with another seed, and a run for each choice.
    """

    name: ClassVar[str] = "sensitivity"
    tasks: ClassVar[tuple[str, ...]] = PAPER_TASKS
    choices: ClassVar[tuple[Variant, ...]] = CHOICES

    robots: int = 100
    """number of robots in each condition of each run"""
    time_scale: float = 1.0
    """factor on every duration, in (0, 1]; below 1 for rehearsals"""

    def baseline(self) -> Experiment:
        """See `VariantStudy.baseline`."""
        size = default_cohort_size(self.robots)
        return Experiment(body="kinematic", cohort_size=size, time_scale=self.time_scale)

    def variants(self) -> Sequence[Variant]:
        """See `VariantStudy.variants`."""
        return [Variant(BASELINE, {}, self.tasks), *self.choices]

    def page(self, out: Path) -> Page:
        """See `Study.page`."""
        runs = self.read(out)
        return Page(markdown(runs, compared(runs, self.choices)))


def compared(
    runs: Mapping[str, Run], choices: Sequence[Variant]
) -> list[tuple[Variant, list[Cell]]]:
    """Returns the cells of each choice compared with the baseline, corrected together."""
    matches = [
        Match(runs[choice.name], runs[BASELINE], condition)
        for choice in choices
        for condition in choice.conditions
    ]
    rest = iter(compare_all(matches))
    return [
        (choice, [next(rest) for _ in range(CELLS * len(choice.conditions))]) for choice in choices
    ]


def markdown(runs: Mapping[str, Run], comparisons: Sequence[tuple[Variant, Sequence[Cell]]]) -> str:
    """Returns the page: the cells that each choice changes, and how much two seeds differ.

    Args:
      runs: Finished runs by name.
      comparisons: Pairs of a choice and its compared cells (`compared`).
    """
    baseline = runs[BASELINE]
    noise = next(cells for choice, cells in comparisons if choice.name == NOISE)
    of_noise = {_place(cell): cell for cell in noise}
    changed = [(choice, cell) for choice, cells in comparisons for cell in cells if cell.differs]
    robots = max(len(baseline.robots(condition)) for condition in baseline.conditions())
    lines = ["### What each choice changes", ""]
    lines += [
        f"In the kinematic simulator, {robots} robots in each condition. {_verdict(comparisons)}",
        "",
    ]
    if changed:
        head = ["choice", "task", "proposer", "cell", "variant", BASELINE, "difference", "Holm"]
        rows = [[*head, "two seeds"]]
        for choice, cell in changed:
            values = [comparison_tables.number(cell, value) for value in (cell.ours, cell.other)]
            values.append(comparison_tables.difference(cell))
            values.append(probability(cell.corrected))
            values.append(comparison_tables.difference(of_noise[_place(cell)]))
            place = [TASK_NAMES[cell.task], cell.proposer, cell.name]
            rows.append([choice.says, *place, *values])
        lines += [*table(rows, "l" * 4 + "r" * 5), ""]
    lines += ["### The noise: two baselines with different seeds", ""]
    for task in baseline.tasks():
        own = [cell for cell in noise if cell.task == task]
        lines += [f"**{title(task, baseline.experiment)}**", ""]
        lines += [*comparison_tables.table("another seed", BASELINE, own), ""]
    every = [cell for _, cells in comparisons for cell in cells]
    return "\n".join([*lines, comparison_tables.note(every)])


def _verdict(comparisons: Sequence[tuple[Variant, Sequence[Cell]]]) -> str:
    every = [cell for _, cells in comparisons for cell in cells]
    unchanged = [
        f"{choice.says} (in {len(choice.conditions)} conditions)"
        for choice, cells in comparisons
        if not any(cell.differs for cell in cells)
    ]
    none = f" No cell differs with: {'; '.join(unchanged)}." if unchanged else ""
    return (
        f"After Holm's correction {sum(cell.differs for cell in every)} of {len(every)} cells "
        f"differ from the baseline's.{none} *Difference*: variant minus baseline. *Two seeds*: "
        "another seed minus baseline, two independent groups of robots."
    )


def _place(cell: Cell) -> tuple[str, str]:
    return str(cell.condition), cell.name
