"""The memory that a plan needs, compared with the machine's before anything is written."""

from __future__ import annotations

import collections
import math
from typing import TYPE_CHECKING

from ...controller.creative_memory import NoisePatterns
from ..errors import InputError
from ..machine import machine_bytes
from .agent import network_shapes

if TYPE_CHECKING:
    from .conditions import Condition
    from .experiment import Experiment
    from .plan import Plan

_FLOAT, _COUNT = 4, 2  # bytes of a weight, and of a minute's count
_ROBOT, _WARP = 8000, 25_000  # bytes of a robot's physics in MuJoCo; more in MuJoCo Warp
_PROCESS = 190_000_000  # bytes that a process without robots shares with no other
_COPIES = 3  # of results and of checkpoints, while they are joined and written


def cohort_bytes(experiment: Experiment, condition: Condition) -> int:
    """Returns about how many bytes a cohort needs, beyond an empty process's.

    Measured with 1 to 1000 ideas and hidden neurons: right within a factor of 2.
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
    """Returns about how many bytes the largest job of a plan needs.

    On tensors a job has the cohorts of all conditions of a task.
    """
    jobs: collections.Counter[str] = collections.Counter()
    for condition in plan.robots:
        job = condition.task if plan.experiment.on_tensors else str(condition)
        jobs[job] += cohort_bytes(plan.experiment, condition)
    return max(jobs.values())


def results_bytes(plan: Plan) -> int:
    """Returns about how many bytes the results of a plan need while they are written."""
    total = 0
    for condition, robots in plan.robots.items():
        shapes = network_shapes(plan.experiment, condition) or {}
        weights = 2 * sum(map(math.prod, shapes.values()))  # before and after training
        minutes = len(plan.experiment.schedule(condition.task).steps_of_minutes())
        total += robots * (_FLOAT * weights + _COUNT * minutes)
    return _COPIES * total


def check_memory(plan: Plan, at_once: int = 1, whole: Plan | None = None) -> None:
    """Raises InputError where a plan needs more memory than the machine has.

    Args:
      plan: Robots that are to be simulated.
      at_once: Number of jobs that the machine runs at a time.
      whole: All robots that the results will have; None for those of `plan`.
    """
    size, whole = plan.experiment.cohort_size, whole or plan
    jobs = min(at_once, sum(plan.robots.values()) // size)
    what = f"{sum(whole.robots.values())} robots in cohorts of {size}, {jobs} at a time"
    needed = jobs * job_bytes(plan) + (jobs - 1) * _PROCESS + results_bytes(whole)
    check_fits(what, needed)


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
    check_fits(f"a cohort of {condition}", _COPIES * state)
    check_fits(f"{robots} robots of {condition}", _COPIES * kept)


def check_fits(what: str, needed: int) -> None:
    """Raises InputError where something needs more bytes of memory than the machine has."""
    if needed > (most := machine_bytes()):
        raise InputError(
            f"{what} would need about {needed / 2**30:.1f} GiB of memory; this machine has "
            f"{most / 2**30:.1f} GiB"
        )
