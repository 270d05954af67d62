"""What each ingredient of our brain is worth: one taken away at a time.

    python -m musebot.protocols.ablation OUT --robots 60 --processes 2

lives creative robots with `steady`, and with `steady` without one ingredient at a time, each as a
run in a folder of OUT, and writes `OUT/ablation.md`. The same command goes on where it was stopped.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated

from ...controller import BRAINS, INGREDIENTS
from ...models import Kinematics
from ..analysis import comparison as beside
from ..analysis.comparison import Cell, Side
from ..errors import InputError, run_module
from ..experiment.experiment import TASKS, Body, Experiment, Plan, default_cohort_size, told
from ..experiment.schedules import NAMES
from ..options import COHORT_SIZE, HERE, TASKS_TOLD, KinematicsTold, Out, WorkersTold, option
from ..reporting import tables
from . import variants as series

PAGE = "ablation.md"
WHOLE, _PROPOSER = "steady", "creative"

# No signal of wall avoidance saturates: without these its lives are the same, to the bit.
_SPOTS_ALONE = ("raw_signals", "raw_reward")


def _without(ingredient: str) -> str:
    return f"{WHOLE}-{ingredient}"


def matters(ingredient: str, task: str) -> bool:
    """Whether an ingredient can change a life."""
    return task == "spot_finding" or ingredient not in _SPOTS_ALONE


def plans(robots: int, tasks: Sequence[str], experiment: Experiment) -> dict[str, Plan]:
    """Which lives are wanted, by the name of their brain, the whole one's first.

    Args:
      robots: with each brain in each task.
      tasks: one or both.
      experiment: what is shared, all but the brain.

    Raises:
      InputError: a number or a task makes no sense.
    """
    if robots < 1:
        raise InputError(f"the number of robots must be at least 1, got {robots}")
    for name in tasks:
        if name not in TASKS:
            raise InputError(f"the task must be one of {', '.join(TASKS)}, got {name!r}")
    if not tasks:
        raise InputError("at least one task is needed")
    wanted = {}
    for ingredient in (None, *INGREDIENTS):
        name = _without(ingredient) if ingredient else WHOLE
        conditions = [
            (task, _PROPOSER)
            for task in TASKS
            if task in tasks and (ingredient is None or matters(ingredient, task))
        ]
        if conditions:
            shared = dataclasses.replace(experiment, brain=BRAINS[name])
            wanted[name] = Plan.of(shared, conditions, robots)
    return wanted


def judge(sides: Mapping[str, Side]) -> dict[tuple[str, str], tuple[Cell, Cell]]:
    """The whole brain against it without each ingredient, corrected over all cells.

    Args:
      sides: the runs, by the name of their brain.

    Returns:
      By task and ingredient, the cells of `beside.outcomes`; ours are the whole brain's.
    """
    matches = {
        (task, ingredient): beside.Match(sides[WHOLE], less, (task, _PROPOSER))
        for task in TASKS
        for ingredient in INGREDIENTS
        if (less := sides.get(_without(ingredient)))
        and (task, _PROPOSER) in less.results.conditions()
    }
    return dict(zip(matches, beside.outcomes([*matches.values()]), strict=True))


def markdown(sides: Mapping[str, Side]) -> str:
    """What each ingredient is worth, and in which task it earns its place, as Markdown.

    Args:
      sides: the runs, by the name of their brain.
    """
    judged = judge(sides)
    tasks = list(dict.fromkeys(task for task, _ in judged))
    rows = [["ingredient", *(NAMES[task] for task in tasks)], ["---"] * (1 + len(tasks))]
    for ingredient in INGREDIENTS:
        verdicts = [_in_a_word(judged.get((task, ingredient), ())) for task in tasks]
        rows.append([ingredient, *verdicts])
    lines = [*map(tables.line, rows)]
    head = ["taken away", "", "robots", "whole", "without", "difference", "Holm", "the ingredient"]
    for task in tasks:
        rows = [head, ["---", "---", *["---:"] * 5, "---"]]
        for (where, ingredient), cells in judged.items():
            if where == task:
                rows += [_row(ingredient, cell) for cell in cells]
        title = tables.title(task, sides[WHOLE].experiment)
        lines += ["", f"### {title}", "", *map(tables.line, rows)]
    note = (
        "An ingredient earns its place in a task where the brain does worse without it in one of "
        "the two numbers, and better in none. Robots: how many have a value, of the whole brain "
        "and without the ingredient; L has none where the spot was never met, or no wall. A dash: "
        "without the ingredient lives are the same, to the bit. What each ingredient is: "
        "`controller/parameters.py`.\n"
    )
    every = [cell for cells in judged.values() for cell in cells]
    whole = sides[WHOLE]
    return "\n".join(
        [*lines, "", note, beside.note(every), beside.described(whole.name, whole.experiment), ""]
    )


def _in_a_word(cells: Sequence[Cell]) -> str:
    if not cells:
        return "-"
    verdicts = {beside.verdict(cell) for cell in cells}
    if {"better", "worse"} <= verdicts:
        return "earns and harms"
    return "earns" if "better" in verdicts else "harms" if "worse" in verdicts else "undecided"


def _row(ingredient: str, cell: Cell) -> list[str]:
    numbers = [beside.number(cell, value) for value in (cell.ours, cell.other)]
    robots = " and ".join(map(str, cell.robots))
    difference = [beside.difference(cell), beside.probability(cell.corrected)]
    return [ingredient, cell.name, robots, *numbers, *difference, _in_a_word([cell])]


def report(out: Path) -> str:
    """The page that a finished ablation comes to, as Markdown; changes nothing.

    Raises:
      InputError: a run is missing or damaged.
    """
    whole = series.read(out, [WHOLE])
    tasks = [task for task, _ in whole[WHOLE].results.conditions()]
    lived = [_without(i) for i in INGREDIENTS if any(matters(i, task) for task in tasks)]
    return markdown(whole | series.read(out, lived))


def main(
    out: Out,
    robots: int = 60,
    cohort_size: Annotated[int | None, option(*COHORT_SIZE)] = None,
    task: Annotated[tuple[str, ...], option(f"{TASKS_TOLD} ..", "both")] = TASKS,
    seed: int = 1,
    body: Body = "mujoco",
    kinematics: KinematicsTold = (),
    time_scale: float = 1.0,
    workers: WorkersTold = HERE,
) -> None:
    """Lives our brain without one ingredient at a time, and says what each is worth.

    Args:
      out: folder of the runs, a folder each, and of ablation.md; an unfinished one goes on.
      robots: with each brain in each task.
      cohort_size: robots in lockstep on one random stream.
      task: what has to be learnt.
      seed: of every random stream.
      body: mujoco, or the kinematic stand-in.
      kinematics: of the stand-in, such as lag=0.08.
      time_scale: below 1 shortens every duration, for rehearsals.
      workers: who lives them.
    """
    shared = Experiment(
        cohort_size=default_cohort_size(robots) if cohort_size is None else cohort_size,
        seed=seed,
        body=body,
        kinematics=told(Kinematics(), kinematics),
        time_scale=time_scale,
    )
    series.conduct(out, plans(robots, task, shared), workers, PAGE, report)


if __name__ == "__main__":
    run_module(main)
