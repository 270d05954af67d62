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
from ...experiment.plan import Variant, changed

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


def combined(start: Experiment, row: np.ndarray) -> Experiment:
    """Returns an experiment with the choices' values at the levels of a row of `DESIGN`."""
    for choice, sign in zip(CHOICES, row, strict=False):
        start = changed(start, choice.values[int(sign < 0)])
    return start


_FINALISTS = (
    Variant("final-plain", {}, says="the plain reading"),
    Variant("final-inverse", {"nose": "inverse"}, ("spot_finding",), says="r/d in Eq. 3"),
    Variant("final-front", {"nose_place": "front"}, ("spot_finding",), says="nose at the front"),
    Variant("final-holds", {"kinematics.wall": "holds"}, says="moves up to the wall"),
    Variant(
        "final-noise", {"brain.noise_steps": 0}, proposers=("creative",), says="noise for life"
    ),
    Variant(
        "final-noise-inverse",
        {"brain.noise_steps": 0, "nose": "inverse"},
        ("spot_finding",),
        ("creative",),
        "noise for life, r/d in Eq. 3",
    ),
)
FINALISTS = {finalist.name: finalist for finalist in _FINALISTS}
"""The readings of stage 3. In other conditions robots live as in the plain reading, or as in the
finalist whose other fields are the same."""
