"""A robot's stored brain put back into a robot, and set before one of its tests again."""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Sequence

import numpy as np
import torch

from ...controller import PROPOSERS
from ..agents.base import Brain, make_agent
from ..errors import InputError
from ..experiment.experiment import Experiment, check_condition
from ..experiment.schedules import control_steps
from ..results.results import Results
from ..simulation.cohort import place
from .episode import Act, Episode, check_phase, check_seed

# Which of the two stored brains sat the test.
_BRAINS = {"pre": "before", "post": "after"}


@dataclasses.dataclass(frozen=True)
class Candidate:
    """A robot of a run, as its stored brain sits a test again.

    Attributes:
      experiment: of the run.
      results: of the run.
      task: what the robot had to learn.
      proposer: how its actions were proposed.
      robot: its number within the condition.
      phase: "pre" or "post", the test before or after training.
      seed: of the brain's noise, drawn anew: the random stream of a life is not stored.
    """

    experiment: Experiment
    results: Results
    task: str
    proposer: str
    robot: int
    phase: str
    seed: int = 0

    def brain(self) -> Brain:
        """Returns the brain that the robot had in the test, as a batch of one.

        Raises:
          InputError: there is no such robot, or its life was invalid; or a number makes no
            sense.
        """
        check_condition(self.task, self.proposer)
        if self.proposer not in PROPOSERS:
            raise InputError(
                f"only brains of the three proposers can be put back, not {self.proposer}"
            )
        check_phase(self.phase)
        check_seed(self.seed)
        row = _row(self.results, self.task, self.proposer, self.robot)
        which = [(row, _BRAINS[self.phase])]
        return stored_brains(
            self.experiment, self.results, self.task, self.proposer, which, self.seed
        )

    def act(self) -> Act:
        """Returns what drives the robot: the brain, neither learning nor exploring.

        Its noise is drawn anew: the random stream of the life is not stored, so what the noise
        makes the robot do differs from what it once did.

        Raises:
          InputError: see `brain`.
        """
        return functools.partial(self.brain().act, learning=False)

    def episode(self) -> Episode:
        """Returns the first stretch of the test, robot and spot where it begins.

        Raises:
          InputError: see `brain`.
        """
        act = self.act()
        start = next(p for p in self.experiment.schedule(self.task).phases if p.part == self.phase)
        batch, random = self.experiment.batch(self.task, 1), np.random.default_rng(self.seed)
        place(batch, start, random)
        return Episode(
            self.experiment.arena_task(self.task),
            f"{self.proposer} proposer, robot {self.robot}",
            self.phase == "post",
            batch,
            act,
            control_steps(start.minutes),
            random,
        )


def stored_brains(
    experiment: Experiment,
    results: Results,
    task: str,
    proposer: str,
    which: Sequence[tuple[int, str]],
    seed: int,
) -> Brain:
    """Returns stored brains of a condition as one batch.

    Args:
      experiment: of the run.
      results: of the run.
      task: what the robots had to learn.
      proposer: how their actions were proposed.
      which: each brain's row within the condition, and "before" or "after" training.
      seed: of the batch's one random stream.
    """
    prefix = f"{task}/{proposer}/after/"
    names = [name.removeprefix(prefix) for name in results.brains if name.startswith(prefix)]
    networks = {
        name: torch.from_numpy(
            np.stack([results.brains[f"{task}/{proposer}/{when}/{name}"][i] for i, when in which])
        )
        for name in names
    }
    brain = make_agent(experiment, task, proposer, len(which), seed)
    assert isinstance(brain, Brain)  # of a proposer, not of a user's factory
    brain.controller.load_networks(networks)
    return brain


def _row(results: Results, task: str, proposer: str, robot: int) -> int:
    """Where a robot stands among those of its condition."""
    rows = results.of(task, proposer)
    if not rows:
        lived = "; ".join(f"{t}, {p}" for t, p in results.conditions()) or "none"
        raise InputError(f"no robot of {task}, {proposer} has lived in this run, only: {lived}")
    numbers = [row.robot for row in rows]
    if robot not in numbers:
        raise InputError(
            f"the robots of {task}, {proposer} are {min(numbers)} to {max(numbers)}, got {robot}"
        )
    row = numbers.index(robot)
    if not rows[row].valid:
        raise InputError(
            f"robot {robot} of {task}, {proposer} is invalid: its simulation became unstable"
        )
    return row
