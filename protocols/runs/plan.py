"""Plans: which robots are wanted, into which cohorts they split, and how many bytes they need."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterable, Mapping
from typing import Any

from ...controller.creative_memory import NoisePatterns
from ...fields import shown
from ...tasks.kinematic import kinematic_definition
from ...tasks.world import World
from ..errors import InputError
from ..machine import machine_bytes
from .conditions import CohortKey, Condition
from .experiment import Experiment
from .run import network_shapes

MOST_ROBOTS = 1_000_000  # robots in a condition
_FLOAT, _COUNT = 4, 2  # bytes of a weight, and of a minute's count
_ROBOT, _WARP = 8000, 25_000  # bytes of a robot's physics in MuJoCo; extra bytes in MuJoCo Warp
_PROCESS = 190_000_000  # bytes of a process without robots, except those shared with others
_COPIES = 3  # of results or checkpoints in memory, while they are joined and written


@dataclasses.dataclass(frozen=True)
class Plan:
    """An experiment and the robots that are wanted.

    Attributes:
      experiment: Seed, cohort size, body, brain and other fields that decide the lives.
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
            life = self.experiment.life_of(condition.life)
            if self.experiment.on_tensors and life.worlds != (World(),):
                raise InputError(f"{life.name} is simulated on CPUs only: its world changes")
            if self.experiment.body == "kinematic":
                try:
                    kinematic_definition(life.task)
                except ValueError as error:
                    raise InputError(str(error)) from error
            check_robots(robots)
            if robots % size:
                raise InputError(
                    f"robots must be a multiple of the cohort size, {size}, got {robots} "
                    "(--set cohort_size=N sets it for a new folder)"
                )

    def cohorts(self) -> list[CohortKey]:
        """Returns all cohorts, longest lives first, so that processes end at similar times."""
        life_of, size = self.experiment.life_of, self.experiment.cohort_size
        longest = sorted(self.robots, key=lambda condition: -sum(life_of(condition.life).steps()))
        return [CohortKey(c, index) for c in longest for index in range(self.robots[c] // size)]

    def merged_with(self, older: Plan) -> Plan:
        """Returns a plan with the robots of both plans, and the experiment of the older one."""
        conditions = sorted({*older.robots, *self.robots})
        robots = {c: max(self.robots.get(c, 0), older.robots.get(c, 0)) for c in conditions}
        return Plan(older.experiment, robots)


def check_robots(robots: Any) -> None:
    """Raises InputError unless a condition can have this number of robots."""
    if type(robots) is not int or not 1 <= robots <= MOST_ROBOTS:
        raise InputError(
            f"robots must be a whole number from 1 to {MOST_ROBOTS}, got {shown(robots)}"
        )


def default_cohort_size(*robots: int, most: int = 250) -> int:
    """Returns the largest common divisor, at most `most`, of the numbers of robots.

    Raises:
      InputError: the numbers only split into many small cohorts, whose simulation is slow.
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


# ---- Memory ----


def cohort_bytes(experiment: Experiment, condition: Condition) -> int:
    """Returns about how many bytes a cohort needs, in addition to those of its process.

    The estimate was within a factor of 2 of measurements with 1 to 1000 ideas and hidden neurons.
    """
    robot, shared = _ROBOT + (_WARP if experiment.physics == "warp" else 0), 0
    if (shapes := network_shapes(experiment, condition)) is not None:
        brain, sizes = experiment.brain, {k: math.prod(shape) for k, shape in shapes.items()}
        connections = sum(size for name, size in sizes.items() if name.startswith("memory."))
        hidden = brain.evaluation_hidden + (brain.memory_hidden if connections else 0)
        actions = len(brain.fixed_motors) ** 2 if condition.proposer == "fixed" else brain.ideas
        robot += _FLOAT * (actions * (connections + 3 * hidden) + 4 * sum(sizes.values()))
        shared = _FLOAT * 4 * NoisePatterns.POOL * connections
    return experiment.cohort_size * robot + shared


def job_bytes(plan: Plan) -> int:
    """Returns about how many bytes the largest job of a plan needs: that of its largest cohort."""
    return max(cohort_bytes(plan.experiment, condition) for condition in plan.robots)


def results_bytes(plan: Plan) -> int:
    """Returns about how many bytes the results of a plan need while they are written."""
    total = 0
    for condition, robots in plan.robots.items():
        shapes = network_shapes(plan.experiment, condition) or {}
        weights = 2 * sum(map(math.prod, shapes.values()))  # before and after training
        minutes = len(plan.experiment.life_of(condition.life).steps_of_minutes())
        total += robots * (_FLOAT * weights + _COUNT * minutes)
    return _COPIES * total


def check_memory(plan: Plan, at_once: int = 1, whole: Plan | None = None) -> None:
    """Raises InputError if a plan needs more memory than the machine has.

    Args:
      plan: Plan of the robots that are to be simulated.
      at_once: Largest number of jobs that the machine runs at a time.
      whole: Plan of all robots of the run, also of finished ones; None for `plan`.
    """
    size, whole = plan.experiment.cohort_size, whole or plan
    jobs = min(at_once, sum(plan.robots.values()) // size)
    what = f"{sum(whole.robots.values())} robots in cohorts of {size}, {jobs} at a time"
    needed = jobs * job_bytes(plan) + (jobs - 1) * _PROCESS + results_bytes(whole)
    _check_fits(what, needed)


def check_agent_memory(plan: Plan, condition: Condition, state: float, weights: float) -> None:
    """Raises InputError if an agent needs more memory than the machine has.

    Args:
      plan: Plan of the run, which has the cohort size and the number of robots.
      condition: Condition whose robots the agent drives.
      state: Bytes per robot of `Agent.state`; several copies exist while a checkpoint is written.
      weights: Bytes per robot of `Agent.weights`, which are kept before and after training.
    """
    robots, size = plan.robots[condition], plan.experiment.cohort_size
    _check_fits(f"a cohort of {condition}", _COPIES * size * state)
    _check_fits(f"{robots} robots of {condition}", _COPIES * robots * 2 * weights)


def _check_fits(what: str, needed: float) -> None:
    if needed > (most := machine_bytes()):
        raise InputError(
            f"{what} would need about {needed / 2**30:.1f} GiB of memory; this machine has "
            f"{most / 2**30:.1f} GiB"
        )
