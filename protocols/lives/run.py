"""A run as a value: what was measured of its robots, and what is derived from that."""

from __future__ import annotations

import dataclasses
import importlib
from collections.abc import Iterable, Mapping
from typing import Any, Literal

import numpy as np

from ...tasks.arena import CONTROL_TIMESTEP
from ..errors import InputError
from ..storage import Shapes
from .agent import network_shapes
from .conditions import CohortKey, Condition
from .experiment import Experiment
from .learn_ability import INVALID, Summary, category, classes, learn_ability, summarise
from .schedules import SCHEDULES, STAGES, Schedule, control_steps

When = Literal["before", "after"]
WHEN: tuple[When, When] = ("before", "after")
NetworkArrays = dict[str, np.ndarray]
_TESTS: tuple[Literal["pre", "post"], ...] = ("pre", "post")


# ---- What is measured ----


@dataclasses.dataclass(frozen=True)
class Lives:
    """What was measured of N robots of a condition: a finished cohort, or several in their order.

    Attributes:
      events: Number of control steps in contact, or in the spot, in the test before training, in
        training, and in the test after training, shape (N, 3).
      minutes: Number of control steps in contact, or in the spot, in each of M simulated minutes,
        shape (N, M).
      valid: False for a robot whose simulation became unstable, shape (N,).
      before: Networks before training, each of shape (N, ...).
      after: Networks after training, each of shape (N, ...).
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
        """Returns the lives whose arrays have the names that `arrays` gives them."""
        before, after = (
            {k.removeprefix(f"{when}/"): v for k, v in arrays.items() if k.startswith(f"{when}/")}
            for when in WHEN
        )
        return cls(arrays["events"], arrays["minutes"], arrays["valid"], before, after)


Measured = Mapping[Condition, Lives]
"""What was measured of all robots of each condition, in the order of the tables."""


def joined(older: Measured, cohorts: Iterable[tuple[CohortKey, Lives]]) -> Measured:
    """Adds finished cohorts to the robots of a run, in the order of the cohorts' numbers."""
    parts = {condition: [lives.arrays()] for condition, lives in older.items()}
    for key, lives in sorted(cohorts, key=lambda item: item[0]):
        parts.setdefault(key.condition, []).append(lives.arrays())
    return {
        condition: Lives.of({k: np.concatenate([p[k] for p in own]) for k in own[0]})
        for condition, own in sorted(parts.items())
    }


def check_lives_shapes(
    experiment: Experiment,
    condition: Condition,
    robots: int,
    shapes: Shapes,
    *,
    networks: bool = True,
) -> None:
    """Checks names, dtypes and shapes of the arrays of lives, before any array is read.

    Args:
      experiment: Experiment of the robots.
      condition: Condition of the robots.
      robots: Number of robots, N.
      shapes: Dtype and shape of each array, by its name in `Lives.arrays`.
      networks: Whether the networks are among the arrays.

    Raises:
      ValueError: an array is missing, foreign, or of another dtype or shape.
    """
    minutes = len(experiment.schedule(condition.task).steps_of_minutes())
    counts: Shapes = {
        "events": ("I32", (robots, len(STAGES))),
        "minutes": ("I16", (robots, minutes)),
        "valid": ("BOOL", (robots,)),
    }
    found: Shapes = {}
    if networks:
        own = network_shapes(experiment, condition)
        if own is None:  # an agent has weights of any kind
            found = {k.partition("/")[2]: x for k, x in shapes.items() if k.startswith("after/")}
        else:
            found = {name: ("F32", (robots, *shape)) for name, shape in own.items()}
    both = {
        f"{when}/{name}": (dtype, (robots, *shape[1:]))
        for when in WHEN
        for name, (dtype, shape) in found.items()
    }
    check_same_shapes({**counts, **both}, shapes)


def check_same_shapes(wanted: Shapes, found: Shapes) -> None:
    """Raises ValueError where arrays are missing or foreign, or differ in dtype or shape."""
    for name in sorted({*wanted, *found}):
        if name not in found:
            raise ValueError(f"{name} is missing")
        if name not in wanted:
            raise ValueError(f"{name} is no array of it")
        if found[name] != wanted[name]:
            (dtype, shape), (own, size) = wanted[name], found[name]
            raise ValueError(f"{name} must be {dtype} of shape {shape}, got {own} of shape {size}")


def check_lives(schedule: Schedule, lives: Lives) -> None:
    """Checks the values of lives whose shapes were checked.

    Raises:
      ValueError: a count is impossible, or a weight of a valid robot is not finite.
    """
    check_events(schedule, lives.events, lives.minutes, sum(schedule.steps()))
    for networks in (lives.before, lives.after):
        check_finite(networks, lives.valid)


def check_events(schedule: Schedule, events: np.ndarray, minutes: np.ndarray, step: int) -> None:
    """Checks the counts of events of robots up to a control step.

    Args:
      schedule: Schedule of the robots.
      events: Control steps with the event in each part of the life, shape (N, 3).
      minutes: Control steps with the event in each minute, shape (N, M).
      step: Number of control steps simulated.

    Raises:
      ValueError: a count is impossible.
    """
    done = np.array([schedule.steps_of(part) for part in STAGES])
    within = np.clip(step - np.concatenate([[0], done.cumsum()[:-1]]), 0, done)
    whole = schedule.steps_of_minutes()
    of_minutes = np.clip(step - np.arange(len(whole)) * control_steps(1), 0, whole)
    for name, counts, most in (("events", events, within), ("minutes", minutes, of_minutes)):
        wrong = np.argwhere((counts < 0) | (counts > most))
        if len(wrong):
            robot, column = wrong[0]
            raise ValueError(
                f"{name}, row {robot}, column {column}: must lie in [0, {most[column]}], "
                f"got {counts[robot, column]}"
            )
    apart = np.flatnonzero(events.sum(axis=1) != minutes.sum(axis=1))
    if len(apart):
        raise ValueError(f"row {apart[0]}: its events and its minutes have different sums")


def check_finite(arrays: Mapping[str, np.ndarray], valid: np.ndarray) -> None:
    """Raises ValueError where a valid robot has a number that is not finite; each (N, ...)."""
    for name, array in arrays.items():
        broken = ~np.isfinite(array).reshape(len(array), -1).all(axis=1) & valid
        if broken.any():
            raise ValueError(f"{name}, row {broken.argmax()}: must be finite")


# ---- What is derived ----


@dataclasses.dataclass(frozen=True)
class Robot:
    """A robot, a row of robots.csv.

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
      robots: Each of the N robots.
      curves: Share of each of M simulated minutes in contact, or in the spot, shape (N, M).
      networks: Networks before and after training, each of shape (N, ...); empty if the agent has
        no weights.
    """

    robots: list[Robot]
    curves: np.ndarray
    networks: Mapping[When, NetworkArrays]

    @classmethod
    def of(cls, experiment: Experiment, condition: Condition, lives: Lives) -> ConditionResults:
        """Derives the results of a condition from what was measured of all its robots."""
        task, schedule = condition.task, experiment.schedule(condition.task)
        pre, post = (lives.events[:, part] * CONTROL_TIMESTEP for part in (0, 2))
        found = learn_ability(pre, post, schedule.wanted)
        robots = [
            Robot(
                task,
                condition.proposer,
                experiment.seed,
                index // experiment.cohort_size,
                index,
                round(float(pre[index]), 1),
                round(float(post[index]), 1),
                float(found[index]) if valid else float("nan"),
                category_in(task, found[index]) if valid else INVALID,
            )
            for index, valid in enumerate(lives.valid)
        ]
        steps = schedule.steps_of_minutes().astype(np.float32)
        curves = (lives.minutes / steps).astype(np.float32)
        return cls(robots, curves, {"before": lives.before, "after": lives.after})


Results = Mapping[Condition, ConditionResults]
"""The results of each condition, in the order of the tables."""


def results_of(experiment: Experiment, measured: Measured) -> Results:
    """Derives the results of a run from what was measured."""
    return {c: ConditionResults.of(experiment, c, lives) for c, lives in measured.items()}


def collect(experiment: Experiment, cohorts: Iterable[tuple[CohortKey, Lives]]) -> Results:
    """Derives the results of finished cohorts, which are all cohorts of their conditions."""
    return results_of(experiment, joined({}, cohorts))


def category_in(task: str, ability: float) -> str:
    """Returns the class of a robot of a task: "genius" or "ignorant" if its L is NaN."""
    name = category(ability)
    return SCHEDULES[task].unmeasured if name == "unmeasured" else name


@dataclasses.dataclass(frozen=True)
class Run:
    """A run, as read from its folder.

    Attributes:
      name: Name of the run's folder.
      experiment: Experiment that decided the robots' lives.
      results: Results of the robots, by condition.
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

    def tasks(self) -> list[str]:
        """Returns the tasks that have robots, in the order of the tables."""
        return list(dict.fromkeys(condition.task for condition in self.results))

    def proposers(self, task: str) -> list[str]:
        """Returns the proposers of a task, in the order of the tables."""
        return [condition.proposer for condition in self.results if condition.task == task]

    def robots(self, condition: Condition) -> list[Robot]:
        """Returns the rows of a condition, invalid robots included; empty if there are none."""
        return self.results[condition].robots if condition in self.results else []

    def valid(self, condition: Condition) -> list[Robot]:
        """Returns the rows of a condition's valid robots."""
        return [row for row in self.robots(condition) if row.valid]

    def valid_rows(self, condition: Condition) -> list[int]:
        """Returns the indices of a condition's valid robots."""
        return [index for index, row in enumerate(self.robots(condition)) if row.valid]

    def curves(self, condition: Condition) -> np.ndarray:
        """Returns each valid robot's share of each minute in contact, or in the spot, (n, M)."""
        return self.results[condition].curves[self.valid_rows(condition)]

    def networks(self, condition: Condition, when: When) -> NetworkArrays:
        """Returns the networks of all robots before or after training, each (N, ...)."""
        return self.results[condition].networks[when] if condition in self.results else {}

    def abilities(self, condition: Condition) -> np.ndarray:
        """Returns L of each valid robot, NaN for a genius or an ignorant, shape (n,)."""
        return abilities(self.valid(condition))

    def classes(self, condition: Condition) -> list[str]:
        """Returns the class of each valid robot, a row of tables 1 and 2."""
        return classes(self.abilities(condition), self.exact_classes)

    def shares(self, condition: Condition, part: Literal["pre", "post"]) -> np.ndarray:
        """Returns each valid robot's share of a test in contact, or in the spot, shape (n,)."""
        return shares(self.valid(condition), self.test_seconds(condition.task), part)

    def summary(self, condition: Condition) -> Summary:
        """Returns the column of table 1 or 2 that a condition fills."""
        rows = self.valid(condition)
        return summarise(
            abilities(rows),
            [row.t_post_s for row in rows],
            self.test_seconds(condition.task),
            invalid=len(self.robots(condition)) - len(rows),
            exact=self.exact_classes,
        )

    def test_seconds(self, task: str) -> float:
        """Returns the duration of a test, equal before and after training, in simulated seconds."""
        return self.experiment.schedule(task).steps_of("post") * CONTROL_TIMESTEP

    def to_frame(self) -> Any:
        """Returns a row for each robot, invalid robots included, as a pandas DataFrame.

        Its columns are those of robots.csv, and `pre_share` and `post_share`: the share of a test
        in contact, or in the spot, in [0, 1].

        Raises:
          InputError: pandas is not installed.
        """
        try:
            pandas = importlib.import_module("pandas")  # optional, in no extra
        except ModuleNotFoundError as error:
            raise InputError("Run.to_frame needs pandas: pip install pandas") from error
        rows = [
            dataclasses.asdict(row)
            | {
                f"{part}_share": float(shares([row], self.test_seconds(row.task), part)[0])
                for part in _TESTS
            }
            for condition in self.conditions()
            for row in self.robots(condition)
        ]
        return pandas.DataFrame(rows)


def abilities(rows: list[Robot]) -> np.ndarray:
    """Returns L of each robot, NaN for a genius or an ignorant, shape (n,)."""
    return np.array([row.learn_ability for row in rows], dtype=float)


def shares(rows: list[Robot], test_seconds: float, part: Literal["pre", "post"]) -> np.ndarray:
    """Returns each robot's share of a test in contact, or in the spot, in [0, 1], shape (n,)."""
    times = [row.t_pre_s if part == "pre" else row.t_post_s for row in rows]
    return np.array(times, dtype=float) / test_seconds
