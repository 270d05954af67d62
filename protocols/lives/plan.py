"""Plans: which robots of an experiment are wanted, and into which cohorts they split."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterable, Mapping
from typing import Any

from ...fields import shown
from ..errors import InputError
from .conditions import CohortKey, Condition
from .experiment import Experiment

MOST_ROBOTS = 1_000_000  # in a condition


@dataclasses.dataclass(frozen=True)
class Plan:
    """The robots of an experiment that are wanted.

    Attributes:
      experiment: Experiment that decides the robots' lives.
      robots: Number of robots in each condition, a multiple of the cohort size.
    """

    experiment: Experiment
    robots: Mapping[Condition, int]

    @classmethod
    def of(cls, experiment: Experiment, conditions: Iterable[Condition], robots: int) -> Plan:
        """Returns a plan with the same number of robots in every condition."""
        return cls(experiment, dict.fromkeys(conditions, robots))

    def __post_init__(self) -> None:
        """Raises InputError where the plan is invalid."""
        if not self.robots:
            raise InputError("at least one task and one proposer are needed")
        size = self.experiment.cohort_size
        for condition, robots in self.robots.items():
            if condition.task not in self.experiment.tasks:
                raise InputError(
                    f"the protocol {self.experiment.protocol} has only "
                    f"{', '.join(self.experiment.tasks)}, got {condition.task}"
                )
            check_robots(robots)
            if robots % size:
                raise InputError(
                    f"robots must be a multiple of the cohort size, {size}, got {robots} "
                    "(--set cohort_size=N sets it for a new folder)"
                )

    @property
    def conditions(self) -> tuple[Condition, ...]:
        """The conditions that have robots."""
        return tuple(self.robots)

    def cohorts(self) -> list[CohortKey]:
        """Returns all cohorts, the longest lives first, so that processes end nearly together."""
        keys = [
            CohortKey(condition, index)
            for condition, robots in self.robots.items()
            for index in range(robots // self.experiment.cohort_size)
        ]
        schedule = self.experiment.schedule
        return sorted(keys, key=lambda key: -sum(schedule(key.condition.task).steps()))

    def merged_with(self, older: Plan) -> Plan:
        """Returns a plan with the robots of both plans.

        Raises:
          InputError: the experiments differ.
        """
        if self.experiment != older.experiment:
            raise InputError("the robots of two experiments cannot be merged")
        conditions = sorted({*older.robots, *self.robots})
        robots = {c: max(self.robots.get(c, 0), older.robots.get(c, 0)) for c in conditions}
        return Plan(self.experiment, robots)


def check_robots(robots: Any) -> None:
    """Raises InputError for a number of robots of a condition that cannot be simulated."""
    if type(robots) is not int or not 1 <= robots <= MOST_ROBOTS:
        raise InputError(
            f"robots must be a whole number from 1 to {MOST_ROBOTS}, got {shown(robots)}"
        )


def default_cohort_size(*robots: int, most: int = 250) -> int:
    """Returns the largest common divisor of numbers of robots that is at most `most`.

    Raises:
      InputError: the robots only split into many small cohorts, which are simulated slowly.
    """
    common = math.gcd(*robots)
    size = max(size for size in range(1, min(most, max(common, 1)) + 1) if common % size == 0)
    if max(robots) > most and size < min(most, *robots) / 10:
        numbers = sorted({*robots})
        more = "numbers with a larger common divisor"
        better = more if numbers[1:] else f"{round(numbers[0] / most) * most} robots"
        raise InputError(
            f"{' and '.join(map(str, numbers))} robots do not split into a few equal cohorts of at "
            f"most {most}; take {better}, or name a cohort size"
        )
    return size


def changed(experiment: Experiment, values: Mapping[str, Any]) -> Experiment:
    """Returns an experiment with some fields replaced; "brain.epsilon" is a field of a part.

    Raises:
      InputError: a value is invalid.
    """
    fields = {name: value for name, value in values.items() if "." not in name}
    inner: dict[str, dict[str, Any]] = {}
    for name, value in values.items():
        part, dotted, own = name.partition(".")
        if dotted:
            inner.setdefault(part, {})[own] = value
    try:
        for part, own in inner.items():
            fields[part] = dataclasses.replace(fields.get(part, getattr(experiment, part)), **own)
        return dataclasses.replace(experiment, **fields)
    except ValueError as error:
        raise InputError(str(error)) from error
