"""The memory that a plan needs, compared with the machine's before anything is written."""

from __future__ import annotations

import dataclasses
import math
from typing import TYPE_CHECKING

from ...controller.creative_memory import NoisePatterns
from ..errors import InputError
from ..machine import machine_bytes
from ..storage import MOST_BYTES
from .agent import network_shapes

if TYPE_CHECKING:
    from .conditions import Condition
    from .experiment import Experiment
    from .plan import Plan

_FLOAT = 4
_BATCH = 8000  # bytes of a robot's physics, measured: 5 to 8 kB
_WARP = 25_000  # bytes of a robot's physics in MuJoCo Warp, the sum of its arrays
_ROW = 1000  # bytes of a row of robots.csv and its objects
_PROCESS = 190_000_000  # bytes that a process without robots shares with no other
_COPIES = 3  # of results and of checkpoints, while they are joined and written


def cohort_bytes(experiment: Experiment, condition: Condition) -> int:
    """Returns about how many bytes a job needs for a cohort, beyond an empty process's.

    Measured with 1 to 1000 ideas and hidden neurons: right within a factor of 2.
    """
    shapes = network_shapes(experiment, condition)
    physics = _BATCH + (_WARP if experiment.physics == "warp" else 0)
    if shapes is None:
        return experiment.cohort_size * physics
    brain = experiment.brain
    sizes = {name: math.prod(shape) for name, shape in shapes.items()}
    connections = sum(size for name, size in sizes.items() if name.startswith("memory."))
    hidden = brain.evaluation_hidden + (brain.memory_hidden if connections else 0)
    actions = len(brain.fixed_motors) ** 2 if condition.proposer == "fixed" else brain.ideas
    of_robot = actions * (connections + 3 * hidden) + 4 * sum(sizes.values())
    patterns = 4 * NoisePatterns.POOL * connections
    return experiment.cohort_size * (physics + _FLOAT * of_robot) + _FLOAT * patterns


@dataclasses.dataclass
class JobKind:
    """Jobs of a plan that need equally much.

    Attributes:
      what: What one of them simulates.
      needed: About how many bytes it needs, beyond an empty process's.
      jobs: Number of such jobs.
    """

    what: str
    needed: int = 0
    jobs: int = 0


def job_kinds(plan: Plan) -> list[JobKind]:
    """Returns the kinds of jobs in a plan.

    On tensors a job has the cohorts of all conditions of a task.
    """
    kinds: dict[str, JobKind] = {}
    for condition, robots in plan.robots.items():
        cohorts = condition.task if plan.experiment.on_tensors else str(condition)
        kind = kinds.setdefault(cohorts, JobKind(f"a cohort of {cohorts}"))
        kind.needed += cohort_bytes(plan.experiment, condition)
        kind.jobs = max(kind.jobs, robots // plan.experiment.cohort_size)
    return [*kinds.values()]


def results_bytes(plan: Plan) -> int:
    """Returns about how many bytes the results of a plan need while they are written."""
    total = brains_bytes(plan)
    for condition, robots in plan.robots.items():
        minutes = len(plan.experiment.schedule(condition.task).steps_of_minutes())
        total += robots * (_ROW + _FLOAT * 2 * minutes)
    return _COPIES * total


def brains_bytes(plan: Plan) -> int:
    """Returns the bytes of all robots' networks, before and after training."""
    total = 0
    for condition, robots in plan.robots.items():
        shapes = network_shapes(plan.experiment, condition) or {}
        total += 2 * _FLOAT * robots * sum(map(math.prod, shapes.values()))
    return total


def check_memory(plan: Plan, at_once: int = 1, whole: Plan | None = None) -> None:
    """Raises InputError where a plan needs more memory than the machine has, or too large files.

    Args:
      plan: Robots that are to be simulated.
      at_once: Number of jobs that the machine runs at a time.
      whole: All robots that the results will have; None for those of `plan`.
    """
    kinds = job_kinds(plan)
    for kind in kinds:
        _check_fits(kind.what, kind.needed)
    if at_once > 1:
        each = [kind.needed for kind in kinds for _ in range(min(kind.jobs, at_once))]
        largest = sorted(each)[-at_once:]
        _check_fits(
            f"{len(largest)} cohort{'s' * (len(largest) > 1)} at a time (--processes)",
            sum(largest) + len(largest) * _PROCESS,
        )
    whole = whole or plan
    robots = f"{sum(whole.robots.values())} robots"
    _check_file(robots, brains_bytes(whole))
    _check_fits(robots, results_bytes(whole))


def check_agent_memory(plan: Plan, condition: Condition, state: int, weights: int) -> None:
    """Raises InputError where an agent needs more memory than the machine has.

    Args:
      plan: Plan of the run.
      condition: Condition of the agent.
      state: Bytes of a cohort's checkpoint, which is copied while it is written.
      weights: Bytes of a cohort's weights.
    """
    robots = plan.robots[condition]
    kept = 2 * weights * robots // plan.experiment.cohort_size  # before and after training
    for what, size in (
        (f"a cohort of {condition}", state),
        (f"{robots} robots of {condition}", kept),
    ):
        _check_fits(what, _COPIES * size)
        _check_file(what, size)


def _check_file(what: str, size: int) -> None:
    if size > MOST_BYTES:
        raise InputError(
            f"{what} would need a file of {size / 2**30:.1f} GiB; files may have "
            f"{MOST_BYTES / 2**30:.0f} GiB"
        )


def _check_fits(what: str, needed: int) -> None:
    if needed > (most := machine_bytes()):
        raise InputError(
            f"{what} would need about {needed / 2**30:.1f} GiB of memory; this machine has "
            f"{most / 2**30:.1f} GiB"
        )
