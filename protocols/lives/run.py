"""A run as a value: its name, its experiment and its results."""

from __future__ import annotations

import dataclasses
import importlib
from typing import Any, Literal

import numpy as np

from ...tasks.arena import CONTROL_TIMESTEP
from ..errors import InputError
from .conditions import Condition
from .experiment import Experiment
from .learn_ability import Summary, classes, summarise
from .results import NetworkArrays, Results, Robot, When

_TESTS: tuple[Literal["pre", "post"], ...] = ("pre", "post")


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
