"""Chooses robots of a run as examples for the report's figures and films."""

from __future__ import annotations

import dataclasses
from collections.abc import Collection

from ..lives.conditions import Condition
from ..lives.run import Run
from ..lives.schedules import SCHEDULES


@dataclasses.dataclass(frozen=True)
class Example:
    """A robot that is an example of a kind.

    Attributes:
      kind: Kind of example: "genius" or "ignorant", "learner", or "spoiled".
      row: Index of the robot among all robots of its condition, from 0.
      robot: Number of the robot, unique within its condition.
    """

    kind: str
    row: int
    robot: int


def proposer_of(run: Run, task: str) -> str:
    """Returns the proposer of the examples: creative if the run has it; "" without robots."""
    names = [c.proposer for c in run.conditions() if c.task == task and c.has_brain]
    return "creative" if "creative" in names else next(iter(names), "")


def examples(run: Run, task: str) -> list[Example]:
    """Returns an unmeasured robot, and the robots that gained and lost most in training.

    The gain is the change of the time in contact (or in the spot) from the test before training to
    the test after it, positive for an improvement. A kind without a robot is left out.
    """
    if not (proposer := proposer_of(run, task)):
        return []
    schedule, rows = SCHEDULES[task], run.robots(Condition(task, proposer))
    sign = 1 if schedule.wanted else -1
    gains = {
        index: sign * (row.t_post_s - row.t_pre_s)
        for index, row in enumerate(rows)
        if row.valid and row.category != schedule.unmeasured
    }
    unmeasured = [i for i, row in enumerate(rows) if row.category == schedule.unmeasured]
    best, worst = (pick(gains, key=gains.__getitem__, default=None) for pick in (max, min))
    found = [(schedule.unmeasured, unmeasured[0] if unmeasured else None)]
    found.append(("learner", best if best is not None and gains[best] > 0 else None))
    found.append(("spoiled", worst if worst is not None and gains[worst] < 0 else None))
    return [Example(kind, i, rows[i].robot) for kind, i in found if i is not None]


def gains(kinds: Collection[str]) -> str:
    """Returns a sentence, and a space, on those of the kinds that gained or lost; or empty text."""
    words = {
        "learner": "the learner gained most",
        "spoiled": "the spoiled robot lost most",
    }
    found = ", ".join(text for kind, text in words.items() if kind in kinds)
    return f"{found[0].upper()}{found[1:]} between the two tests. " if found else ""


def favourite(run: Run, task: str) -> Example | None:
    """Returns the learner; the first example if there is no learner; None without examples."""
    found = examples(run, task)
    return next((one for one in found if one.kind == "learner"), found[0] if found else None)
