"""Puts a stored brain back into a robot at the start of a test."""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Sequence

import numpy as np
import torch

from ...controller import PROPOSERS
from ..agents.factory import make_agent
from ..agents.neurocontroller import NeurocontrollerAgent
from ..errors import InputError
from ..experiment.conditions import Condition
from ..experiment.schedules import control_steps
from ..results.results import When
from ..results.run import Run
from ..simulation.placement import place
from .episode import Act, Episode, check_phase, check_seed

# Which of the two stored brains drove the robot in each test.
_BRAINS: dict[str, When] = {"pre": "before", "post": "after"}


@dataclasses.dataclass(frozen=True)
class StoredRobot:
    """A robot of a run that repeats a test with its stored brain.

    Attributes:
      run: Run of the robot.
      condition: Condition of the robot.
      robot: Number of the robot within its condition.
      phase: Test to repeat: "pre" before training, or "post" after training.
      seed: Seed of the brain's noise, because the run does not store the original random stream.
    """

    run: Run
    condition: Condition
    robot: int
    phase: str
    seed: int = 0

    def brain(self) -> NeurocontrollerAgent:
        """Returns the robot's brain at the time of the test, as a batch of one.

        Raises:
          InputError: there is no such robot, its simulation was invalid, or a value is invalid.
        """
        if not self.condition.has_brain:
            raise InputError(
                f"only robots with one of the proposers {', '.join(PROPOSERS)} have a stored "
                f"brain, got {self.condition.proposer}"
            )
        check_phase(self.phase)
        check_seed(self.seed)
        which: list[tuple[int, When]] = [(self._row(), _BRAINS[self.phase])]
        return stored_brains(self.run, self.condition, which, self.seed)

    def act(self) -> Act:
        """Returns the function that drives the robot: its brain, with frozen weights.

        The brain's noise differs from that in the original test, and so does the robot's motion.

        Raises:
          InputError: see `brain`.
        """
        return functools.partial(self.brain().act, learning=False)

    def episode(self) -> Episode:
        """Returns the first phase of the test, with robot and spot at their start places.

        Raises:
          InputError: see `brain`.
        """
        act, experiment, task = self.act(), self.run.experiment, self.condition.task
        start = next(p for p in experiment.schedule(task).phases if p.part == self.phase)
        batch, random = experiment.batch(task, 1), np.random.default_rng(self.seed)
        place(batch, start, random)
        return Episode(
            experiment.arena_task(task),
            f"{self.condition.proposer} proposer, robot {self.robot}",
            self.phase == "post",
            batch,
            act,
            control_steps(start.minutes),
            random,
        )

    def _row(self) -> int:
        """Returns the robot's index among the rows of its condition."""
        robots = self.run.robots(self.condition)
        if not robots:
            known = ", ".join(map(str, self.run.conditions())) or "none"
            raise InputError(f"the run has no robots of {self.condition}; it has {known}")
        numbers = [row.robot for row in robots]
        if self.robot not in numbers:
            raise InputError(
                f"the robots of {self.condition} are {min(numbers)} to {max(numbers)}, "
                f"got {self.robot}"
            )
        row = numbers.index(self.robot)
        if not robots[row].valid:
            raise InputError(
                f"robot {self.robot} of {self.condition} is invalid: its simulation became unstable"
            )
        return row


def stored_brains(
    run: Run, condition: Condition, which: Sequence[tuple[int, When]], seed: int
) -> NeurocontrollerAgent:
    """Returns stored brains of a condition as one batch.

    Args:
      run: Run of the brains.
      condition: Condition of the brains.
      which: For each brain, a pair: the robot's row within the condition, and "before" or "after"
        for the brain before or after training.
      seed: Seed of the batch's random stream.
    """
    stored = run.results[condition].networks
    networks = {
        name: torch.from_numpy(np.stack([stored[when][name][row] for row, when in which]))
        for name in stored["after"]
    }
    agent = make_agent(run.experiment, condition, len(which), seed)
    assert isinstance(agent, NeurocontrollerAgent)  # of a proposer, not of a user's factory
    agent.controller.load_networks(networks)
    return agent
