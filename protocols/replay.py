"""A robot's stored brain put back into a robot, and set before one of its tests again."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Sequence

import numpy as np
import torch

from ..controller import PROPOSERS
from ..tasks import CONTROL_TIMESTEP
from .agents import Brain, make_agent
from .cohort import place
from .errors import InputError
from .experiment import Experiment, check_condition
from .learn_ability import INVALID
from .results import Results
from .schedules import control_steps

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
            raise InputError(f"only the paper's brains can be put back, not {self.proposer}")
        if self.phase not in _BRAINS:
            raise InputError(f"the phase must be one of {', '.join(_BRAINS)}, got {self.phase!r}")
        if not 0 <= self.seed < 2**63:
            raise InputError(f"the seed must lie in [0, 2^63), got {self.seed}")
        row = _row(self.results, self.task, self.proposer, self.robot)
        which = [(row, _BRAINS[self.phase])]
        return stored_brains(
            self.experiment, self.results, self.task, self.proposer, which, self.seed
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
    if rows[row].category == INVALID:
        raise InputError(
            f"robot {robot} of {task}, {proposer} is invalid: its simulation became unstable"
        )
    return row


@dataclasses.dataclass(frozen=True)
class Moment:
    """A robot at the start of a control step.

    Attributes:
      time: simulated seconds since the test began.
      pose: x, y in metres and heading in radians, shape (3,).
      sensordata: what MuJoCo last measured, shape (nsensordata,).
      motors: what the brain answers, left and right, shape (2,).
      event: whether the robot is in contact, or in the spot; never so at the start.
      event_seconds: how long it has been so, since the test began.
    """

    time: float
    pose: np.ndarray
    sensordata: np.ndarray
    motors: np.ndarray
    event: bool
    event_seconds: float


class Reenactment:
    """A test sat again by a stored brain: no learning, no exploration, and noise of its own.

    The random stream of the life is not stored, so what the brain's noise makes it do differs
    from what it once did.

    Attributes:
      batch: the robot, a batch of one.
      seconds: how long the test lasts, simulated.
    """

    def __init__(self, candidate: Candidate) -> None:
        """Puts robot and spot where the first stretch of the test begins.

        Raises:
          InputError: see `Candidate.brain`.
        """
        self._brain = candidate.brain()
        experiment, task = candidate.experiment, candidate.task
        start = next(p for p in experiment.schedule(task).phases if p.part == candidate.phase)
        self._steps = control_steps(start.minutes)
        self.seconds = self._steps * CONTROL_TIMESTEP
        self.batch = experiment.batch(task, 1)
        place(self.batch, start, np.random.default_rng(candidate.seed))

    def _act(self) -> np.ndarray:
        state = self.batch.rules.state(self.batch.sensordata).astype(np.float32)
        return self._brain.act(state, learning=False)

    def moments(self) -> Iterator[Moment]:
        """Lives through the test, once; ends early where the simulation becomes unstable."""
        batch, events, event = self.batch, 0, False
        for step in range(self._steps + 1):
            motors = self._act()
            yield Moment(
                step * CONTROL_TIMESTEP,
                batch.pose[0],
                batch.sensordata[0].copy(),
                motors[0],
                event,
                events * CONTROL_TIMESTEP,
            )
            batch.step(motors)
            if not batch.valid.all():
                return
            event = bool(batch.rules.event(batch.sensordata)[0])
            events += event
