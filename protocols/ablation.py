"""What each ingredient of our brain is worth: the brain without it, one ingredient at a time.

    python -m musebot.protocols.ablation OUT --robots 60 --processes 2

lives creative robots with `steady`, and with `steady` without each of its ingredients, each as a
run in a folder of OUT, and writes `OUT/ablation.md`. The same command goes on where it was stopped.
"""

from __future__ import annotations

import dataclasses
import math
import os
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated

import numpy as np
import tyro

from ..controller import BRAINS, INGREDIENTS
from ..models import Kinematics
from . import beside, intervals, series, tables
from .beside import Side
from .errors import InputError, exit_status
from .experiment import TASKS, Body, Experiment, Plan, default_cohort_size, told
from .intervals import Interval
from .learn_ability import INVALID
from .progress import bar
from .schedules import NAMES, SCHEDULES

PAGE = "ablation.md"
WHOLE, _PROPOSER = "steady", "creative"
_ABILITY = "mean L"


@dataclasses.dataclass(frozen=True)
class Loss:
    """What robots lose in a row of a table when an ingredient is taken away.

    Attributes:
      left: the row's value without the ingredient.
      size: by how much the whole brain does better; negative where it does worse.
      interval: 95 %, of the size; unknown where all robots are alike.
    """

    left: float
    size: float
    interval: Interval

    @property
    def earns(self) -> bool:
        """Whether the ingredient earns its place: the interval excludes that nothing is lost."""
        return self.interval[0] > 0

    @property
    def harms(self) -> bool:
        """Whether the brain does better without it."""
        return self.interval[1] < 0


def plans(robots: int, tasks: Sequence[str], experiment: Experiment) -> dict[str, Plan]:
    """Which lives are wanted, by the name of their brain, the whole one's first.

    Args:
      robots: with each brain in each task.
      tasks: one or both.
      experiment: what is shared, all but the brain and the size of a cohort.

    Raises:
      InputError: a number makes no sense.
    """
    if robots < 1:
        raise InputError(f"the number of robots must be at least 1, got {robots}")
    if not tasks:
        raise InputError("at least one task is needed")
    conditions = [(task, _PROPOSER) for task in TASKS if task in tasks]
    size = default_cohort_size(robots)
    return {
        name: Plan.of(
            dataclasses.replace(experiment, brain=BRAINS[name], cohort_size=size),
            conditions,
            robots,
        )
        for name in (WHOLE, *map(_without, INGREDIENTS))
    }


def _without(ingredient: str) -> str:
    return f"{WHOLE}-{ingredient}"


def losses(whole: Side, less: Side, task: str) -> dict[str, Loss]:
    """What is lost in mean L and in the time after training, by the name of the row.

    Args:
      whole: a run of the whole brain.
      less: a run without an ingredient.
      task: that both have lives of.
    """
    paired, all_in, taken = beside.measured(whole, less, (task, _PROPOSER))
    found = {}
    for name in (_ABILITY, list(all_in)[-1]):
        pair = all_in[name], taken[name]
        left = beside.value_of(pair[1], beside.mean)
        size = beside.value_of(pair[0], beside.mean) - left
        low, high = intervals.difference(*pair, beside.mean, paired)
        if not (name == _ABILITY or SCHEDULES[task].wanted):  # time in contact is better short
            size, low, high = -size, -high, -low
        found[name] = Loss(left, size, (low, high))
    return found


def report(out: Path) -> str:
    """The page that a finished ablation comes to, as Markdown; changes nothing.

    Raises:
      InputError: a run is missing or damaged.
    """
    return markdown(series.read(out, [WHOLE, *map(_without, INGREDIENTS)]))


def markdown(sides: Mapping[str, Side]) -> str:
    """A table a task with a row an ingredient, and which of them earn their place.

    Args:
      sides: the runs, by the name of their brain.
    """
    whole = sides[WHOLE]
    tasks = [task for task in TASKS if (task, _PROPOSER) in whole.results.conditions()]
    pairs = [(task, ingredient) for task in tasks for ingredient in INGREDIENTS]
    with bar() as progress:
        found = {
            (task, ingredient): losses(whole, sides[_without(ingredient)], task)
            for task, ingredient in progress.track(pairs, description="comparing")
        }
    earning = [i for i in INGREDIENTS if any(_any(found[task, i], "earns") for task in tasks)]
    idle = [i for i in INGREDIENTS if i not in earning]
    harming = [i for i in idle if any(_any(found[task, i], "harms") for task in tasks)]
    lines = [
        f"- Earn their place, in one task at least: {_listed(earning)}.",
        f"- Are not seen to: {_listed([i for i in idle if i not in harming])}.",
        f"- Do harm: {_listed(harming)}.",
        "",
    ]
    for task in tasks:
        lines += [f"### {NAMES[task]}", "", *_table(sides, task, found), ""]
    note = (
        "Creative robots, without one ingredient at a time. Loss: by how much the whole brain does "
        "better, in brackets its 95 % interval, BCa bootstrap; bold where it excludes 0. Two of "
        "robots born with the same brain are pairs, all others two independent groups. The "
        f"intervals are of each number alone: of {2 * len(found)} one in twenty excludes 0 by "
        "chance. What each ingredient is: `controller/parameters.py`."
    )
    return "\n".join([*lines, note, "", beside.described(whole.name, whole.experiment), ""])


def _any(found: Mapping[str, Loss], what: str) -> bool:
    return any(getattr(loss, what) for loss in found.values())


def _listed(ingredients: Sequence[str]) -> str:
    return ", ".join(ingredients) or "none"


def _table(
    sides: Mapping[str, Side], task: str, found: Mapping[tuple[str, str], Mapping[str, Loss]]
) -> list[str]:
    names = list(found[task, next(iter(INGREDIENTS))])
    head = ["taken away", "robots", *(cell for name in names for cell in (name, "loss"))]
    rows = [head, ["---", *["---:"] * (len(head) - 1)]]
    _, own, _ = beside.measured(sides[WHOLE], sides[WHOLE], (task, _PROPOSER))
    first = [[tables.number(beside.value_of(own[name], beside.mean)), ""] for name in names]
    rows.append(["nothing", _robots(sides[WHOLE], task), *sum(first, [])])
    for ingredient in INGREDIENTS:
        lost = [_cells(loss) for loss in found[task, ingredient].values()]
        rows.append([ingredient, _robots(sides[_without(ingredient)], task), *sum(lost, [])])
    return [tables.line(row) for row in rows]


def _cells(loss: Loss) -> list[str]:
    low, high = loss.interval
    size = "-" if math.isnan(loss.size) else f"{loss.size:+.4f}"
    if not (math.isnan(low) or math.isnan(high)):
        size += f" [{low:+.4f}, {high:+.4f}]"
    return [tables.number(loss.left), f"**{size}**" if loss.earns or loss.harms else size]


def _robots(side: Side, task: str) -> str:
    kinds = np.array([row.category for row in side.results.of(task, _PROPOSER)])
    invalid = int((kinds == INVALID).sum())
    return f"{len(kinds) - invalid}" + (f" (and {invalid} invalid)" if invalid else "")


def main(
    out: Annotated[Path, tyro.conf.Positional],
    robots: int = 60,
    task: tuple[str, ...] = TASKS,
    seed: int = 1,
    body: Body = "mujoco",
    kinematics: tuple[str, ...] = (),
    time_scale: float = 1.0,
    processes: int = len(os.sched_getaffinity(0)),
) -> None:
    """Lives our brain without each of its ingredients, and says what each is worth.

    Args:
      out: folder of the runs, a folder each, and of ablation.md; an unfinished one goes on.
      robots: with each brain in each task.
      task: wall_avoidance, spot_finding, or both.
      seed: of every random stream.
      body: mujoco, or the kinematic stand-in.
      kinematics: of the stand-in, such as lag=0.08.
      time_scale: below 1 shortens every duration, for rehearsals.
      processes: cohorts that live at a time, one core each.
    """
    for name in task:
        if name not in TASKS:
            raise InputError(f"the task must be one of {', '.join(TASKS)}, got {name!r}")
    shared = Experiment(
        seed=seed, body=body, kinematics=told(Kinematics(), kinematics), time_scale=time_scale
    )
    series.conduct(out, plans(robots, task, shared), processes, PAGE, report)


if __name__ == "__main__":
    sys.exit(exit_status(lambda: tyro.cli(main)))
