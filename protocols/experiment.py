"""What an experiment is: the parameters that decide every life, and their file."""

from __future__ import annotations

import dataclasses
import json
import os
import platform
import zlib
from collections.abc import Iterable
from importlib import metadata
from pathlib import Path
from typing import Any

import numpy as np

from .. import __version__
from ..controller import PROPOSERS, Parameters
from ..tasks.senses import NoseForm
from .schedules import SCHEDULES, Schedule
from .storage import DamagedFileError, write_atomically

TASKS = tuple(SCHEDULES)


class InputError(Exception):
    """What the user asked for cannot be done; the text says why, in one sentence."""


@dataclasses.dataclass(frozen=True)
class CohortKey:
    """Which robots live in lockstep: a condition (task, proposer) and a number in it."""

    task: str
    proposer: str
    index: int

    def __str__(self) -> str:
        """The name of the cohort's files."""
        return f"{self.task}-{self.proposer}-{self.index:04d}"


@dataclasses.dataclass(frozen=True)
class Experiment:
    """Everything that decides a cohort's lives, to the bit on one machine.

    How many robots there are, in which conditions, and how many processes run them is not
    part of it: more robots are more cohorts.

    Attributes:
      seed: of every random stream.
      cohort_size: robots that live in lockstep on one random stream.
      time_scale: every duration of the schedules is multiplied by it; 1 is the paper's.
      nose: the form of Eq. 3 (see `tasks.senses.Nose`).
      learn_across_placement: whether the step from before a robot is placed anew to after it
        is learnt from (not stated in the paper).
      brain: the neurocontroller's numbers.
    """

    seed: int = 1
    cohort_size: int = 50
    time_scale: float = 1.0
    nose: NoseForm = "inverse"
    learn_across_placement: bool = False
    brain: Parameters = Parameters()

    def __post_init__(self) -> None:
        """Raises InputError where a number makes no sense."""
        for name in ("seed", "cohort_size"):
            if not isinstance(getattr(self, name), int):
                raise InputError(f"{name} must be a whole number, got {getattr(self, name)}")
        if self.seed < 0:
            raise InputError(f"the seed must not be negative, got {self.seed}")
        if self.cohort_size < 1:
            raise InputError(f"the cohort size must be at least 1, got {self.cohort_size}")
        if not 0 < self.time_scale <= 1:
            raise InputError(f"the time scale must lie in (0, 1], got {self.time_scale}")
        if self.nose not in ("inverse", "printed"):
            raise InputError(f"the nose must be 'inverse' or 'printed', got {self.nose!r}")

    def schedule(self, task: str) -> Schedule:
        """The schedule of a task's lives, scaled."""
        return SCHEDULES[task].scaled(self.time_scale)

    def seeds(self, key: CohortKey) -> tuple[int, np.random.Generator]:
        """A cohort's own random streams: a seed for its brains, a generator for its world.

        They depend on the experiment's seed, the condition's name and the cohort's number,
        on nothing else.
        """
        condition = zlib.crc32(f"{key.task}/{key.proposer}".encode())
        sequence = np.random.SeedSequence(self.seed, spawn_key=(condition, key.index))
        brains, world = sequence.spawn(2)
        return int(brains.generate_state(1, np.uint64)[0] >> 1), np.random.default_rng(world)


@dataclasses.dataclass(frozen=True)
class Plan:
    """Which of an experiment's lives are wanted.

    Attributes:
      experiment: what decides the lives.
      conditions: pairs of task and proposer.
      robots: in each condition, a multiple of the cohort size.
    """

    experiment: Experiment
    conditions: tuple[tuple[str, str], ...]
    robots: int

    def __post_init__(self) -> None:
        """Raises InputError where the plan makes no sense."""
        if not isinstance(self.robots, int):
            raise InputError(f"robots must be a whole number, got {self.robots}")
        size = self.experiment.cohort_size
        for task, proposer in self.conditions:
            if task not in TASKS:
                raise InputError(f"the task must be one of {', '.join(TASKS)}, got {task!r}")
            if proposer not in PROPOSERS:
                names = ", ".join(PROPOSERS)
                raise InputError(f"the proposer must be one of {names}, got {proposer!r}")
        if not self.conditions:
            raise InputError("at least one task and one proposer are needed")
        if self.robots < 1:
            raise InputError(f"the number of robots must be at least 1, got {self.robots}")
        if self.robots % size:
            raise InputError(
                f"the number of robots must be a multiple of the cohort size, {size}, "
                f"got {self.robots}"
            )

    def cohorts(self) -> list[CohortKey]:
        """All cohorts, the longest lives first, so that processes end together."""
        keys = [
            CohortKey(task, proposer, index)
            for task, proposer in self.conditions
            for index in range(self.robots // self.experiment.cohort_size)
        ]
        return sorted(keys, key=lambda key: -sum(self.experiment.schedule(key.task).steps()))

    def merged_with(self, older: Plan) -> Plan:
        """The plan that asks for the lives of both (of the same experiment)."""
        conditions = dict.fromkeys((*older.conditions, *self.conditions))
        ordered = tuple(sorted(conditions, key=condition_order))
        return Plan(self.experiment, ordered, max(self.robots, older.robots))


def condition_order(condition: Iterable[str]) -> tuple[int, int]:
    """Sorts conditions as the paper's tables do."""
    task, proposer = condition
    return TASKS.index(task), PROPOSERS.index(proposer)  # type: ignore[arg-type]


def default_cohort_size(robots: int, most: int = 250) -> int:
    """The largest divisor of `robots` that is at most `most`.

    Raises:
      InputError: they only split into many small cohorts, which would live slowly.
    """
    size = max(size for size in range(1, min(most, max(robots, 1)) + 1) if robots % size == 0)
    if robots > most and size < most / 10:
        raise InputError(
            f"{robots} robots do not split into a few equal cohorts of at most {most}; "
            f"take {round(robots / most) * most} robots, or name a cohort size"
        )
    return size


def save_plan(path: Path, plan: Plan) -> None:
    """Writes `experiment.json`: the plan, and on what it runs.

    `made_with` lists every set of versions and machine that lives were lived with: more than
    one where a run was continued or added to elsewhere.
    """
    here = {
        "python": platform.python_version(),
        "musebot": __version__,
        **{name: metadata.version(name) for name in ("mujoco", "dm-control", "numpy", "torch")},
        "cpu": _cpu(),
        "cores": os.cpu_count(),
        "platform": platform.platform(),
    }
    made_with = json.loads(path.read_text())["made_with"] if path.exists() else []
    content = {
        "experiment": dataclasses.asdict(plan.experiment),
        "plan": {"conditions": plan.conditions, "robots": plan.robots},
        "made_with": [*(one for one in made_with if one != here), here],
    }
    write_atomically(path, (json.dumps(content, indent=2) + "\n").encode())


def load_plan(path: Path) -> Plan:
    """Reads `experiment.json`.

    Raises:
      FileNotFoundError: there is none.
      DamagedFileError: it is not one that `save_plan` wrote.
      InputError: its numbers make no sense.
    """
    text = path.read_bytes()
    try:
        content: dict[str, Any] = json.loads(text)
        fields = content["experiment"]
        brain = fields["brain"] | {"fixed_motors": tuple(fields["brain"]["fixed_motors"])}
        experiment = Experiment(**(fields | {"brain": Parameters(**brain)}))
        conditions = tuple((task, proposer) for task, proposer in content["plan"]["conditions"])
        return Plan(experiment, conditions, content["plan"]["robots"])
    except (ValueError, KeyError, TypeError) as error:
        raise DamagedFileError(f"{path} is not an experiment of musebot's ({error!r})") from error


def _cpu() -> str:
    info = Path("/proc/cpuinfo")
    if info.exists():
        for line in info.read_text().splitlines():
            if line.startswith("model name"):
                return line.split(":", 1)[1].strip()
    return platform.processor()
