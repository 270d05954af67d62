"""A run in memory: measurements of its robots, and results derived from these."""

from __future__ import annotations

import dataclasses
import functools
import math
from collections.abc import Iterable, Mapping
from types import MappingProxyType
from typing import Literal

import numpy as np

from ...controller.neurocontroller import Neurocontroller
from ...tasks.episode import CONTROL_TIMESTEP
from ...tasks.lives import STAGES
from ..agents.signals import senses_of
from .conditions import CohortKey, Condition
from .experiment import Experiment
from .learn_ability import INVALID, Summary, category, classes, learn_ability, summarise

When = Literal["before", "after"]
WHEN: tuple[When, When] = ("before", "after")
NetworkArrays = dict[str, np.ndarray]


# ---- What is measured ----


@dataclasses.dataclass(frozen=True)
class Lives:
    """Measurements of N robots of a condition: of one finished cohort, or of several in order.

    Attributes:
      events: Number of control steps with the measured event, such as contact, shape (N, 3): in the
        test before training, in training, and in the test after training.
      minutes: Number of control steps in contact, or in the spot, in each of M simulated minutes,
        shape (N, M).
      valid: False for a robot with an unstable simulation or a weight that is not finite.
        Shape (N,).
      before: Weights before training, by name, each of shape (N, ...); empty if not kept.
      after: Weights after training, by name, each of shape (N, ...); empty if not kept.
    """

    events: np.ndarray
    minutes: np.ndarray
    valid: np.ndarray
    before: NetworkArrays
    after: NetworkArrays

    def arrays(self) -> dict[str, np.ndarray]:
        """Returns all arrays by their names in files, such as "events" and "after/memory.x"."""
        networks = {
            f"{when}/{name}": array
            for when, arrays in zip(WHEN, (self.before, self.after), strict=True)
            for name, array in arrays.items()
        }
        return {"events": self.events, "minutes": self.minutes, "valid": self.valid, **networks}

    @classmethod
    def of(cls, arrays: Mapping[str, np.ndarray]) -> Lives:
        """Returns the lives that have these arrays, named as by the method `arrays`."""
        before, after = (
            {k.removeprefix(f"{when}/"): v for k, v in arrays.items() if k.startswith(f"{when}/")}
            for when in WHEN
        )
        return cls(arrays["events"], arrays["minutes"], arrays["valid"], before, after)


Measured = Mapping[Condition, Lives]
"""Measurements of all robots of each condition, in the order of the tables."""


def joined(older: Measured, cohorts: Iterable[tuple[CohortKey, Lives]]) -> Measured:
    """Returns the measurements of a run, followed by those of new cohorts in their order."""
    parts = {condition: [lives.arrays()] for condition, lives in older.items()}
    for key, lives in sorted(cohorts, key=lambda item: item[0]):
        parts.setdefault(key.condition, []).append(lives.arrays())
    return {
        condition: Lives.of({k: np.concatenate([p[k] for p in own]) for k in own[0]})
        for condition, own in sorted(parts.items())
    }


@functools.lru_cache(maxsize=64)
def network_shapes(
    experiment: Experiment, condition: Condition
) -> Mapping[str, tuple[int, ...]] | None:
    """Returns the shape of each array of one robot's networks; None if it has no brain."""
    if not condition.has_brain:
        return None
    senses = senses_of(experiment.life_of(condition.life).task)
    controller = Neurocontroller(experiment.brain, condition.proposer, 1, senses, 0)
    shapes = {name: tuple(tensor.shape[1:]) for name, tensor in controller.networks().items()}
    return MappingProxyType(shapes)


# ---- What is derived ----


@dataclasses.dataclass(frozen=True)
class Robot:
    """Results of a robot: a row of robots.csv. Cells about tests that a life lacks are empty.

    Attributes:
      task: Name of the robot's life, such as "spot_finding".
      proposer: Name of the proposer of the robot's actions, or of its agent's factory.
      seed: Seed of the experiment, equal for all robots of a run.
      cohort: Number of the robot's cohort within the condition, from 0.
      robot: Number of the robot within the condition, from 0.
      t_pre_s: Time in contact, or in the spot, in the test before training, in [s].
      t_post_s: Time in contact, or in the spot, in the test after training, in [s].
      learn_ability: Learn Ability L (Eq. 4); NaN (an empty cell) for a genius, an ignorant or an
        invalid robot.
      category: Class of the robot by its unrounded L, such as "L = 1" or "genius"; or "invalid".
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
        """Whether the robot's simulation was stable to the end; statistics omit other robots."""
        return self.category != INVALID


@dataclasses.dataclass(frozen=True)
class ConditionResults:
    """The results of all N robots of a condition, rows in the order of the robots' numbers.

    Attributes:
      robots: Rows of the N robots in robots.csv.
      curves: Share of time in contact, or in the spot, in each of M minutes, shape (N, M).
      networks: Networks before and after training, each of shape (N, ...); empty if the agent has
        no weights.
    """

    robots: list[Robot]
    curves: np.ndarray
    networks: Mapping[When, NetworkArrays]

    @classmethod
    def of(cls, experiment: Experiment, condition: Condition, lives: Lives) -> ConditionResults:
        """Derives the results of a condition from the measurements of all its robots."""
        task, life = condition.life, experiment.life_of(condition.life)
        before, _, after = (
            CONTROL_TIMESTEP if life.steps_of(stage) else math.nan for stage in STAGES
        )
        pre, post = lives.events[:, 0] * before, lives.events[:, 2] * after
        found = np.where(lives.valid, learn_ability(pre, post, life.wanted), np.nan)
        names = {"unmeasured": life.unmeasured if life.tested else ""}
        kinds = [names.get(kind, kind) for kind in map(category, found)]
        robots = [
            Robot(
                task,
                condition.proposer,
                experiment.seed,
                index // experiment.cohort_size,
                index,
                round(float(pre[index]), 1),
                round(float(post[index]), 1),
                float(found[index]),
                kinds[index] if valid else INVALID,
            )
            for index, valid in enumerate(lives.valid)
        ]
        steps = life.steps_of_minutes().astype(np.float32)
        curves = (lives.minutes / steps).astype(np.float32)
        return cls(robots, curves, {"before": lives.before, "after": lives.after})


FEWEST_COMPARED = 20  # robots of a condition with statistical tests and a comparison with the paper

Results = Mapping[Condition, ConditionResults]
"""The results of each condition, in the order of the tables."""


def results_of(experiment: Experiment, measured: Measured) -> Results:
    """Derives the results of a run from the measurements."""
    return {c: ConditionResults.of(experiment, c, lives) for c, lives in measured.items()}


@dataclasses.dataclass(frozen=True)
class Run:
    """A run, as read from its folder.

    Attributes:
      name: Name of the run's folder.
      experiment: Seed, cohort size, body, brain and other fields that decided the lives.
      results: Results by condition, in the order of the tables.
      exact_classes: Whether the tables class robots by their exact L. If False, L is first rounded
        to two decimals.
    """

    name: str
    experiment: Experiment
    results: Results
    exact_classes: bool = False

    def conditions(self) -> list[Condition]:
        """Returns the conditions that have robots, in the order of the tables."""
        return [*self.results]

    @property
    def few(self) -> bool:
        """Whether a condition has fewer than `FEWEST_COMPARED` robots."""
        return any(len(part.robots) < FEWEST_COMPARED for part in self.results.values())

    def tasks(self) -> list[str]:
        """Returns the tasks that have robots, in the order of the tables."""
        return list(dict.fromkeys(condition.life for condition in self.results))

    def proposers(self, task: str) -> list[str]:
        """Returns the proposers of a task, in the order of the tables."""
        return [condition.proposer for condition in self.results if condition.life == task]

    def robots(self, condition: Condition) -> list[Robot]:
        """Returns the rows of a condition, invalid robots included; empty if there are none."""
        return self.results[condition].robots if condition in self.results else []

    def valid(self, condition: Condition) -> list[Robot]:
        """Returns the rows of a condition's valid robots."""
        return [row for row in self.robots(condition) if row.valid]

    def valid_rows(self, condition: Condition) -> list[int]:
        """Returns the indices of the valid robots among a condition's rows."""
        return [index for index, row in enumerate(self.robots(condition)) if row.valid]

    def curves(self, condition: Condition) -> np.ndarray:
        """Returns valid robots' shares of time in contact, or in the spot, by minute, (n, M)."""
        return self.results[condition].curves[self.valid_rows(condition)]

    def networks(self, condition: Condition, when: When) -> NetworkArrays:
        """Returns N robots' networks "before" or "after" training: arrays (N, ...) by name."""
        return self.results[condition].networks[when] if condition in self.results else {}

    def abilities(self, condition: Condition) -> np.ndarray:
        """Returns L of each valid robot, NaN for a genius or an ignorant, shape (n,)."""
        return np.array([row.learn_ability for row in self.valid(condition)], dtype=float)

    def classes(self, condition: Condition) -> list[str]:
        """Returns the class (a row of tables 1 and 2) of each valid robot."""
        return classes(self.abilities(condition), self.exact_classes)

    def shares(self, condition: Condition, part: Literal["pre", "post"]) -> np.ndarray:
        """Returns valid robots' shares of a test's time in contact, or in the spot, shape (n,)."""
        times = [getattr(row, f"t_{part}_s") for row in self.valid(condition)]
        return np.array(times, dtype=float) / self.test_seconds(condition.life, part)

    def life_shares(self, condition: Condition) -> np.ndarray:
        """Returns valid robots' shares of their life in contact, or in the spot, shape (n,)."""
        steps = self.experiment.life_of(condition.life).steps_of_minutes()
        return self.curves(condition) @ (steps / steps.sum())

    def summary(self, condition: Condition) -> Summary:
        """Returns the column of table 1 or 2 that a condition fills."""
        return summarise(
            self.abilities(condition),
            [row.t_post_s for row in self.valid(condition)],
            self.test_seconds(condition.life),
            invalid=len(self.robots(condition)) - len(self.valid(condition)),
            exact=self.exact_classes,
        )

    def test_seconds(self, task: str, part: Literal["pre", "post"] = "post") -> float:
        """Returns the duration of a test, in simulated seconds; NaN for a life without it."""
        return self.experiment.life_of(task).steps_of(part) * CONTROL_TIMESTEP or math.nan
