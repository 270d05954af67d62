"""Puts a stored brain back into a robot at the start of a test."""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Sequence

import numpy as np

from ..agents.base import Agent
from ..agents.names import recorded_name, short_name
from ..agents.neurocontroller import NeurocontrollerAgent
from ..agents.trust import trust
from ..errors import InputError
from ..lives.agent import make_agent
from ..lives.conditions import Condition
from ..lives.placement import place
from ..lives.run import Run, When
from ..lives.schedules import control_steps
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

    def agent(self) -> Agent:
        """Returns the robot's brain, or its agent, at the time of the test, as a batch of one.

        Raises:
          InputError: there is no such robot, its simulation was invalid, its agent is not trusted
            or cannot take over kept weights, or a value is invalid.
        """
        check_phase(self.phase)
        check_seed(self.seed)
        which: list[tuple[int, When]] = [(self._row(), _BRAINS[self.phase])]
        return stored_agent(self.run, self.condition, which, self.seed)

    def act(self) -> Act:
        """Returns the function that drives the robot: its brain or agent, with frozen weights.

        Noise differs from that in the original test, and so does the robot's motion.

        Raises:
          InputError: see `agent`.
        """
        agent = self.agent()
        agent.reset()
        return functools.partial(agent.act, learning=False)

    def episode(self) -> Episode:
        """Returns the first phase of the test, with robot and spot at their start places.

        Raises:
          InputError: see `agent`; or the robot has other dimensions than the one that is drawn.
        """
        act, experiment, task = self.act(), self.run.experiment, self.condition.task
        for name in ("radius", "wheel_base"):
            if (value := getattr(experiment.kinematics, name)) is not None:
                raise InputError(f"films draw the ordinary robot; this run has {name}={value:g}")
        start = next(p for p in experiment.schedule(task).phases if p.part == self.phase)
        batch, random = experiment.batch(task, 1), np.random.default_rng(self.seed)
        place(batch, start, random)
        kind = " proposer" if self.condition.has_brain else ""
        return Episode(
            experiment.arena_task(task),
            f"{short_name(self.condition.proposer)}{kind}, robot {self.robot}",
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
            every = self.run.conditions()
            known = [one for one in every if one.task == self.condition.task]
            names = ", ".join(map(str, known or every)) or "none"
            more = ": --proposer or --agent chooses" if known else ""
            raise InputError(f"the run has no robots of {self.condition}; it has {names}{more}")
        numbers = [row.robot for row in robots]
        if self.robot not in numbers:
            raise InputError(
                f"the robots of {self.condition} are {min(numbers)} to {max(numbers)}, "
                f"got {self.robot}"
            )
        row = numbers.index(self.robot)
        if not robots[row].valid:
            raise InputError(
                f"robot {self.robot} of {self.condition} is invalid: it was stopped, because its "
                "simulation became unstable or its weights were not finite"
            )
        return row


def robots_named(task: str, proposer: str | None, agent: str | None) -> Condition:
    """Returns the condition of the robots that a command names, creative ones by default.

    The code of a user's agent is then trusted.

    Args:
      task: Task of the robots.
      proposer: Name of their proposer.
      agent: Name of their agent, as `musebot run --agent` takes it.

    Raises:
      InputError: a name is unknown, or both are given.
    """
    if proposer and agent:
        raise InputError("a robot has a proposer or an agent, not both")
    if not agent:
        return Condition(task, proposer or "creative")
    name = recorded_name(agent)
    trust(name)
    return Condition(task, name)


def stored_agent(
    run: Run, condition: Condition, which: Sequence[tuple[int, When]], seed: int
) -> Agent:
    """Returns stored brains, or agents with stored weights, of a condition as one batch.

    Args:
      run: Run of the robots.
      condition: Condition of the robots.
      which: For each robot, a pair: its row within the condition, and "before" or "after" for the
        weights before or after training.
      seed: Seed of the batch's random stream.

    Raises:
      InputError: the agent is not trusted, or cannot take over these weights.
    """
    stored = run.results[condition].networks
    weights = {
        name: np.stack([stored[when][name][row] for row, when in which]) for name in stored["after"]
    }
    agent = make_agent(run.experiment, condition, len(which), seed)
    try:
        agent.load_weights(weights)
    except (ValueError, KeyError, NotImplementedError) as error:
        name = short_name(condition.proposer)
        raise InputError(f"{name} cannot take over the weights of {run.name}: {error}") from error
    return agent


def stored_brains(
    run: Run, condition: Condition, which: Sequence[tuple[int, When]], seed: int
) -> NeurocontrollerAgent:
    """Returns stored brains of one of the three proposers as one batch; see `stored_agent`."""
    agent = stored_agent(run, condition, which, seed)
    assert isinstance(agent, NeurocontrollerAgent)  # of a proposer, not of a user's factory
    return agent
