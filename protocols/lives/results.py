"""The results of an experiment: what every robot did, its networks before and after training."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Mapping, Sequence
from typing import TYPE_CHECKING, Literal

import numpy as np

from ...tasks.arena import CONTROL_TIMESTEP
from .conditions import CohortKey, Condition
from .learn_ability import INVALID, category, learn_ability
from .schedules import SCHEDULES

if TYPE_CHECKING:
    from .experiment import Experiment

When = Literal["before", "after"]
WHEN: tuple[When, When] = ("before", "after")
NetworkArrays = dict[str, np.ndarray]


@dataclasses.dataclass(frozen=True)
class Lives:
    """The results of a finished cohort of B robots.

    Attributes:
      events: Number of control steps in contact, or in the spot, in the test before training, in
        training, and in the test after training, shape (B, 3).
      minutes: Number of control steps in contact, or in the spot, in each of M simulated minutes,
        shape (B, M).
      valid: False for a robot whose simulation became unstable, shape (B,).
      before: Networks before training, each of shape (B, ...).
      after: Networks after training, each of shape (B, ...).
    """

    events: np.ndarray
    minutes: np.ndarray
    valid: np.ndarray
    before: NetworkArrays
    after: NetworkArrays


@dataclasses.dataclass(frozen=True)
class Robot:
    """A row of robots.csv.

    Attributes:
      task: Task of the robot.
      proposer: Proposer of the robot's actions, or the factory of its agent.
      seed: Seed of the experiment.
      cohort: Number of the robot's cohort within the condition.
      robot: Number of the robot within the condition.
      t_pre_s: Time in contact, or in the spot, in the test before training, in [s].
      t_post_s: Time in contact, or in the spot, in the test after training, in [s].
      learn_ability: Learn Ability L (Eq. 4); NaN (an empty cell) for a genius, an ignorant or an
        invalid robot.
      category: Class in tables 1 and 2, such as "L = 1" or "genius"; or "invalid".
    """

    task: str
    proposer: str
    seed: int
    cohort: int
    robot: int
    t_pre_s: float
    t_post_s: float
    learn_ability: float
    category: str

    @property
    def valid(self) -> bool:
        """Whether the robot's simulation was stable to the end; others are in no statistic."""
        return self.category != INVALID


@dataclasses.dataclass(frozen=True)
class ConditionResults:
    """The results of all N robots of a condition, rows in the order of the robots' numbers.

    Attributes:
      robots: Rows of robots.csv, one for each of the N robots.
      curves: Share of each of M simulated minutes in contact, or in the spot, shape (N, M).
      networks: Networks before and after training, each of shape (N, ...); empty if the agent has
        no weights.
    """

    robots: list[Robot]
    curves: np.ndarray
    networks: Mapping[When, NetworkArrays]

    def rows(self, which: np.ndarray) -> ConditionResults:
        """Returns the results of some robots.

        Args:
          which: Indices of the robots, shape (n,).
        """
        return ConditionResults(
            [self.robots[i] for i in which],
            self.curves[which],
            {w: {k: x[which] for k, x in nets.items()} for w, nets in self.networks.items()},
        )


Results = Mapping[Condition, ConditionResults]
"""The results of each condition, in the order of the tables."""


def category_in(task: str, ability: float) -> str:
    """Returns the class of a robot of a task: "genius" or "ignorant" if its L is NaN."""
    name = category(ability)
    return SCHEDULES[task].unmeasured if name == "unmeasured" else name


def collect(experiment: Experiment, cohorts: Iterable[tuple[CohortKey, Lives]]) -> Results:
    """Turns finished cohorts into results."""
    found: dict[Condition, list[ConditionResults]] = {}
    for key, lives in sorted(cohorts, key=lambda item: item[0]):
        found.setdefault(key.condition, []).append(_of_cohort(experiment, key, lives))
    return {condition: _joined(parts) for condition, parts in found.items()}


def _of_cohort(experiment: Experiment, key: CohortKey, lives: Lives) -> ConditionResults:
    task, schedule = key.condition.task, experiment.schedule(key.condition.task)
    pre, post = (lives.events[:, part] * CONTROL_TIMESTEP for part in (0, 2))
    found = learn_ability(pre, post, schedule.wanted)
    robots = [
        Robot(
            task,
            key.condition.proposer,
            experiment.seed,
            key.index,
            key.index * experiment.cohort_size + index,
            round(float(pre[index]), 1),
            round(float(post[index]), 1),
            float(found[index]) if valid else float("nan"),
            category_in(task, found[index]) if valid else INVALID,
        )
        for index, valid in enumerate(lives.valid)
    ]
    steps = schedule.steps_of_minutes().astype(np.float32)
    curves = (lives.minutes / steps).astype(np.float32)
    return ConditionResults(robots, curves, {"before": lives.before, "after": lives.after})


def merge(older: Results, newer: Results) -> Results:
    """Adds newer results to older ones; a robot that both have is taken from the older."""
    merged = dict(older)
    for condition, added in newer.items():
        if condition in older:
            known = {row.robot for row in older[condition].robots}
            fresh = [i for i, row in enumerate(added.robots) if row.robot not in known]
            both = _joined([older[condition], added.rows(np.array(fresh, dtype=int))])
            added = both.rows(np.argsort([row.robot for row in both.robots]))
        merged[condition] = added
    return {condition: merged[condition] for condition in sorted(merged)}


def _joined(parts: Sequence[ConditionResults]) -> ConditionResults:
    first = parts[0]
    return ConditionResults(
        [row for part in parts for row in part.robots],
        np.concatenate([part.curves for part in parts]),
        {
            when: {k: np.concatenate([part.networks[when][k] for part in parts]) for k in nets}
            for when, nets in first.networks.items()
        },
    )
