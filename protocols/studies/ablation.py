"""The study of what each ingredient of the brain `steady` contributes, one removed at a time."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated, ClassVar

from ...controller import BRAINS, INGREDIENTS
from ...models import Kinematics
from ..analysis.comparison import Cell, Match, outcomes, verdict
from ..analysis.hypothesis_tests import ALPHA
from ..errors import InputError
from ..experiment.conditions import PAPER_TASKS, Condition
from ..experiment.experiment import Body, Experiment
from ..experiment.overrides import with_overrides
from ..experiment.plan import Variant, default_cohort_size
from ..experiment.schedules import TASK_NAMES
from ..reporting import comparison_tables
from ..reporting.labels import described, title
from ..reporting.markdown import MEANS, table
from ..results.run import Run
from ..shared_options import COHORT_SIZE, TASK_CHOICES, KinematicsOption, option
from .study import Page
from .variants import VariantStudy

WHOLE = "steady"
_PROPOSER = "creative"

# No signal of wall avoidance saturates: without these the lives are the same, bit-exactly.
_ONLY_IN_SPOT_FINDING = ("raw_signals", "raw_reward")


@dataclasses.dataclass
class Ablation(VariantStudy):
    """Remove the ingredients of the brain `steady`, one at a time.

    Simulates creative robots with the whole brain, and with the brain that lacks each ingredient.
    Each run has its own folder.
    """

    name: ClassVar[str] = "ablation"
    ingredients: ClassVar[Sequence[str]] = tuple(INGREDIENTS)

    robots: int = 60
    """number of robots with each brain in each task"""
    task: Annotated[tuple[str, ...], option(f"{TASK_CHOICES} ..", "both")] = PAPER_TASKS
    """tasks to learn"""
    cohort_size: Annotated[int | None, option(*COHORT_SIZE)] = None
    """number of robots in lockstep on one random stream; part of the experiments' identity"""
    seed: int = 1
    """seed from which all random streams derive"""
    body: Body = "mujoco"
    """body of the robot; kinematic: the kinematic simulator"""
    kinematics: KinematicsOption = ()
    """parameters of the kinematic simulator, such as lag=0.08"""
    time_scale: float = 1.0
    """factor on every duration, in (0, 1]; below 1 for rehearsals"""

    def baseline(self) -> Experiment:
        """See `VariantStudy.baseline`."""
        size = self.cohort_size
        return Experiment(
            cohort_size=default_cohort_size(self.robots) if size is None else size,
            seed=self.seed,
            body=self.body,
            kinematics=with_overrides(Kinematics(), self.kinematics),
            time_scale=self.time_scale,
        )

    def variants(self) -> Sequence[Variant]:
        """See `VariantStudy.variants`: the whole brain, and the brains that lack one ingredient."""
        if not self.task:
            raise InputError("at least one task is needed")
        tasks = tuple(sorted(set(self.task), key=[*PAPER_TASKS, *self.task].index))
        whole = Variant(WHOLE, {"brain": BRAINS[WHOLE]}, tasks, (_PROPOSER,))
        found = [whole]
        for ingredient in self.ingredients:
            name = f"{WHOLE}-{ingredient}"
            if affected := tuple(task for task in tasks if matters(ingredient, task)):
                brain = {"brain": BRAINS[name]}
                found.append(Variant(name, brain, affected, (_PROPOSER,)))
        return found

    def page(self, out: Path) -> Page:
        """See `Study.page`."""
        return Page(markdown(self.read(out), self.ingredients))


def matters(ingredient: str, task: str) -> bool:
    """Returns whether an ingredient can affect the robots in a task."""
    return task == "spot_finding" or ingredient not in _ONLY_IN_SPOT_FINDING


def compared(
    runs: Mapping[str, Run], ingredients: Sequence[str]
) -> dict[tuple[str, str], tuple[Cell, Cell]]:
    """Compares the whole brain with the brains that lack one ingredient, corrected together.

    Args:
      runs: Runs by the name of their brain.
      ingredients: Ingredients to report.

    Returns:
      Compared cells (`comparison.outcomes`), by task and ingredient. `ours` in a cell is the value
      of the whole brain.
    """
    whole = runs[WHOLE]
    matches = {
        (task, ingredient): Match(whole, runs[f"{WHOLE}-{ingredient}"], condition)
        for task in PAPER_TASKS
        for ingredient in ingredients
        if f"{WHOLE}-{ingredient}" in runs
        and (condition := Condition(task, _PROPOSER)) in runs[f"{WHOLE}-{ingredient}"].conditions()
    }
    return dict(zip(matches, outcomes([*matches.values()]), strict=True))


def markdown(runs: Mapping[str, Run], ingredients: Sequence[str] = tuple(INGREDIENTS)) -> str:
    """Returns the page: whether each ingredient helps, and in which task.

    Args:
      runs: Runs by the name of their brain.
      ingredients: Ingredients to report.
    """
    comparisons = compared(runs, ingredients)
    tasks = list(dict.fromkeys(task for task, _ in comparisons))
    rows = [["ingredient", *(TASK_NAMES[task] for task in tasks)]]
    for ingredient in ingredients:
        verdicts = [_in_a_word(comparisons.get((task, ingredient), ())) for task in tasks]
        rows.append([ingredient, *verdicts])
    lines = table(rows, "l" * (1 + len(tasks)))
    head = ["removed", "", "robots", "whole", "without", "difference", "Holm", "the ingredient"]
    for task in tasks:
        rows = [head]
        for (where, ingredient), cells in comparisons.items():
            if where == task:
                rows += [_row(ingredient, cell) for cell in cells]
        lines += ["", f"### {title(task, runs[WHOLE].experiment)}", "", *table(rows, "llrrrrrl")]
    note = (
        "An ingredient helps in a task where the brain does worse without it in one of the two "
        "numbers, and better in none. *Robots*: how many have a value, with the whole brain and "
        "without the ingredient; L has none if the robot never met the spot, or a wall. A dash in "
        "the first table: without the ingredient the lives are the same, bit-exactly. Ingredients "
        "are explained in `controller/brains.py`.\n"
    )
    every = [cell for cells in comparisons.values() for cell in cells]
    tests = (
        f"{comparison_tables.pairing(every)}. In brackets: the 95 % interval of the difference "
        f"({MEANS}). *Holm*: permutation test, p corrected over {len(every)} cells, bold below "
        f"{ALPHA:g}. A dash in the other tables: too few measured robots.\n"
    )
    end = [note, tests, described(runs[WHOLE]), ""]
    return "\n".join([*lines, "", *end])


def _in_a_word(cells: Sequence[Cell]) -> str:
    if not cells:
        return "-"
    verdicts = {verdict(cell) for cell in cells}
    if {"better", "worse"} <= verdicts:
        return "helps and harms"
    return "helps" if "better" in verdicts else "harms" if "worse" in verdicts else "undecided"


def _row(ingredient: str, cell: Cell) -> list[str]:
    numbers = [comparison_tables.number(cell, value) for value in (cell.ours, cell.other)]
    robots = " and ".join(map(str, cell.robots))
    difference = comparison_tables.difference(cell)
    p = comparison_tables.corrected(cell)
    return [ingredient, cell.name, robots, *numbers, difference, p, _in_a_word([cell])]
