"""The memory that a plan needs, compared with the machine's before anything is written."""

from __future__ import annotations

import math
import os
from pathlib import Path
from typing import TYPE_CHECKING

from ...controller.noise import NoisePatterns
from ..errors import InputError
from ..storage import MOST_BYTES
from .networks import network_shapes

if TYPE_CHECKING:
    from .conditions import Condition
    from .experiment import Experiment
    from .plan import Plan

_FLOAT = 4
_BATCH = 8000  # bytes of a robot's physics, measured: 5 to 8 kB
_WARP = 25_000  # bytes of a robot's physics in MuJoCo Warp, the sum of its arrays
_ROW = 1000  # bytes of a row of robots.csv and its objects
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


def job_bytes(plan: Plan) -> list[tuple[str, int]]:
    """Returns for each kind of job in a plan what it simulates, and about how many bytes it needs.

    On tensors a job has the cohorts of all conditions of a task.
    """
    needs: dict[str, int] = {}
    for condition in plan.conditions:
        cohorts = condition.task if plan.experiment.on_tensors else str(condition)
        needs[cohorts] = needs.get(cohorts, 0) + cohort_bytes(plan.experiment, condition)
    return [(f"a cohort of {cohorts}", needed) for cohorts, needed in needs.items()]


def results_bytes(plan: Plan) -> int:
    """Returns about how many bytes the results of a plan need while they are written."""
    total = 0
    for condition, robots in plan.robots.items():
        minutes = len(plan.experiment.schedule(condition.task).steps_of_minutes())
        weights = sum(map(math.prod, (network_shapes(plan.experiment, condition) or {}).values()))
        total += round(robots * (_ROW + _FLOAT * (2 * weights + 2 * minutes)))
    return _COPIES * total


def machine_bytes() -> int:
    """Returns the memory of this machine, or of the container that this process is in."""
    total = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    for name in ("memory.max", "memory/memory.limit_in_bytes"):
        try:
            total = min(total, int(Path("/sys/fs/cgroup", name).read_text()))
        except (OSError, ValueError):  # no such container, or "max"
            continue
    return total


def check_memory(plan: Plan, at_once: int = 1) -> None:
    """Raises InputError where a plan needs more memory than the machine has.

    Args:
      plan: Robots that are wanted.
      at_once: Number of jobs that the machine runs at a time.
    """
    for what, needed in job_bytes(plan):
        _check_fits(what, needed)
    if at_once > 1:
        size = plan.experiment.cohort_size
        each = [
            cohort_bytes(plan.experiment, condition)
            for condition, robots in plan.robots.items()
            for _ in range(min(robots // size, at_once))
        ]
        largest = sorted(each)[-at_once:]
        _check_fits(f"{len(largest)} cohorts at a time (--processes)", sum(largest))
    _check_fits(f"{sum(plan.robots.values())} robots", results_bytes(plan))


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
