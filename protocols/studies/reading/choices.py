"""What the study varies: choices that the paper's text leaves open, and where they are combined."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from typing import Any

import numpy as np

from ....controller import PROPOSERS
from ...experiment.conditions import PAPER_TASKS, Condition
from ...experiment.experiment import Experiment
from ...experiment.overrides import READINGS

PLAIN = "plain"
SEEDS = (2004, 2104, 2204, 2304)  # of the four stages
SPEEDS = (0.2, 0.25, 0.12, 0.3)  # [m/s], in the order in which newborns are simulated
WALLS = ("refuses", "holds", "slides")
COLUMNS = [Condition(task, proposer) for task in PAPER_TASKS for proposer in PROPOSERS]


@dataclasses.dataclass(frozen=True)
class Choice:
    """A choice of two values in the screening.

    Attributes:
      says: What +1 and -1 mean, in words.
      values: Values of the experiment's fields at level +1, and at level -1, by field; "part.field"
        is a field of a part.
      tasks: Tasks in which the choice can affect the robots.
    """

    says: str
    values: tuple[Mapping[str, Any], Mapping[str, Any]]
    tasks: tuple[str, ...] = PAPER_TASKS


CHOICES = (
    Choice(
        "a refused move, not one up to the wall",
        ({"kinematics.wall": "refuses"}, {"kinematics.wall": "holds"}),
    ),
    Choice("0.2, not 0.25 m/s", ({"motor_speed": 0.2}, {"motor_speed": 0.25})),
    Choice(
        "nose at the centre, not at the front",
        ({"nose_place": "centre"}, {"nose_place": "front"}),
        ("spot_finding",),
    ),
    Choice(
        "Eq. 3 as printed, not r/d", ({"nose": "printed"}, {"nose": "inverse"}), ("spot_finding",)
    ),
    Choice(
        "value of the selected, not of the best action",
        ({"brain.bootstrap": "on_policy"}, {"brain.bootstrap": "max"}),
    ),
    Choice(
        "no learning across a placement",
        ({"learn_across_placement": False}, {"learn_across_placement": True}),
        ("wall_avoidance",),
    ),
    Choice("start faces the corner, not away", ({"turned_start": 0.0}, {"turned_start": 180.0})),
    Choice("Euler's step, not an arc", ({"kinematics.path": "euler"}, {"kinematics.path": "arc"})),
)
_FIRST = (1, 1, -1, 1, 1, 1, -1, -1, -1, 1, -1)  # row of Plackett and Burman's design of 12 runs
DESIGN = np.array([np.roll(_FIRST, shift) for shift in range(11)] + [[-1] * 11])


def plain(seed: int, robots: int, time_scale: float) -> Experiment:
    """Returns the plain reading (docs/paper.md) with one cohort of robots in each condition."""
    own: Any = READINGS[PLAIN]
    return Experiment(seed=seed, cohort_size=robots, time_scale=time_scale, **own)


def changed(experiment: Experiment, values: Mapping[str, Any]) -> Experiment:
    """Returns an experiment with some fields replaced; "brain.epsilon" is a field of a part."""
    for name, value in values.items():
        part, _, inner = name.partition(".")
        if inner:
            value = dataclasses.replace(getattr(experiment, part), **{inner: value})
        experiment = dataclasses.replace(experiment, **{part: value})
    return experiment


def combined(start: Experiment, row: np.ndarray) -> Experiment:
    """Returns an experiment with the choices' values at the levels of a row of `DESIGN`."""
    for choice, sign in zip(CHOICES, row, strict=False):
        start = changed(start, choice.values[int(sign < 0)])
    return start


@dataclasses.dataclass(frozen=True)
class Finalist:
    """A reading of stage 3.

    Attributes:
      says: What differs from the plain reading, in words.
      values: Values of the experiment's fields that differ, by field as in `Choice`.
      tasks: Tasks that are simulated; in the other task the robots live as in the plain reading.
      proposers: Proposers that are simulated; with the others the robots live as in the plain
        reading, or as in the finalist whose other values are the same.
    """

    says: str
    values: Mapping[str, Any]
    tasks: tuple[str, ...] = PAPER_TASKS
    proposers: tuple[str, ...] = PROPOSERS


FINALISTS: Mapping[str, Finalist] = {
    "final-plain": Finalist("the plain reading", {}),
    "final-inverse": Finalist("r/d in Eq. 3", {"nose": "inverse"}, ("spot_finding",)),
    "final-front": Finalist("nose at the front", {"nose_place": "front"}, ("spot_finding",)),
    "final-holds": Finalist("moves up to the wall", {"kinematics.wall": "holds"}),
    "final-noise": Finalist("noise for life", {"brain.noise_steps": 0}, proposers=("creative",)),
    "final-noise-inverse": Finalist(
        "noise for life, r/d in Eq. 3",
        {"brain.noise_steps": 0, "nose": "inverse"},
        ("spot_finding",),
        ("creative",),
    ),
}
