"""A robot's stored brain put back into a robot, and set before one of its tests again."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Sequence

import numpy as np
import torch

from ..controller import Neurocontroller
from ..tasks import CONTROL_TIMESTEP, Batch, make_batch
from .errors import InputError
from .experiment import Experiment, check_condition
from .learn_ability import INVALID
from .results import Results
from .schedules import Phase, control_steps

# Which of the two stored brains sat the test.
_BRAINS = {"pre": "before", "post": "after"}


def brain_of(
    experiment: Experiment,
    results: Results,
    task: str,
    proposer: str,
    robot: int,
    phase: str,
    seed: int,
) -> Neurocontroller:
    """Returns the brain that a robot had in a test, as a batch of one.

    Args:
      experiment: of the run.
      results: of the run.
      task: what the robot had to learn.
      proposer: how its actions were proposed.
      robot: its number within the condition.
      phase: "pre" for the brain before training, "post" for the one after.
      seed: of the brain's random stream, which was not stored.

    Raises:
      InputError: there is no such robot, or its life was invalid; or a number makes no sense.
    """
    check_condition(task, proposer)
    if phase not in _BRAINS:
        raise InputError(f"the phase must be one of {', '.join(_BRAINS)}, got {phase!r}")
    if not 0 <= seed < 2**63:
        raise InputError(f"the seed must lie in [0, 2^63), got {seed}")
    row = _row(results, task, proposer, robot)
    return stored_brains(experiment, results, task, proposer, [(row, _BRAINS[phase])], seed)


def stored_brains(
    experiment: Experiment,
    results: Results,
    task: str,
    proposer: str,
    which: Sequence[tuple[int, str]],
    seed: int,
) -> Neurocontroller:
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
    sensors = networks["evaluation.hidden_weights"].shape[-1] - 2  # the rest are the motors
    brain = Neurocontroller(experiment.brain, proposer, len(which), sensors, seed)
    brain.load_networks(networks)
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

    def __init__(
        self,
        experiment: Experiment,
        results: Results,
        task: str,
        proposer: str,
        robot: int,
        phase: str,
        seed: int,
    ) -> None:
        """Puts robot and spot where the first stretch of the test begins.

        Args:
          experiment: of the run.
          results: of the run.
          task: what the robot had to learn.
          proposer: how its actions were proposed.
          robot: its number within the condition.
          phase: "pre" or "post", the test before or after training.
          seed: of the brain's noise.

        Raises:
          InputError: see `brain_of`.
        """
        self._brain = brain_of(experiment, results, task, proposer, robot, phase, seed)
        start = next(p for p in experiment.schedule(task).phases if p.part == phase)
        self._steps = control_steps(start.minutes)
        self.seconds = self._steps * CONTROL_TIMESTEP
        self.batch = make_batch(task, 1, nose=experiment.nose)
        _place(self.batch, start)

    @torch.inference_mode()
    def _act(self) -> np.ndarray:
        state = self.batch.rules.state(self.batch.sensordata).astype(np.float32)
        return self._brain.act(torch.from_numpy(state), explore=False).numpy()

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


def _place(batch: Batch, start: Phase) -> None:
    # A test begins at a fixed place; the spot first, so that the robot smells it at once.
    if isinstance(start.spot, tuple):
        batch.place_spot(np.array([0]), np.array([start.spot]))
    if isinstance(start.robot, tuple):
        batch.place(np.array([0]), np.array([start.robot]))
