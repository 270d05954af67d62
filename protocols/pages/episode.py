"""Simulates one robot from a start pose: in a test, or in an episode of any task."""

from __future__ import annotations

import dataclasses
import functools
import itertools
from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING

import numpy as np

from ...tasks import CONTROL_TIMESTEP, Robots, make_batch
from ...tasks.starts import Start, random_spots
from ...tasks.suite import TASKS
from ..errors import InputError

if TYPE_CHECKING:
    from ..agents.ppo import Policies

Act = Callable[[np.ndarray], np.ndarray]
"""Returns motor values in [-0.5, 0.5], shape (B, 2), for observations, float32, shape (B, S)."""

PHASES = ("pre", "post")  # before and after training
_ALONE = np.array([0])  # the robot of a batch of one


@dataclasses.dataclass(frozen=True)
class Moment:
    """A robot at the start of a control step.

    Attributes:
      time: Simulated time since the start of the episode in [s].
      pose: x, y in [m] and heading in [rad], shape (3,).
      spot: x, y of the spot's centre in [m], shape (2,).
      sensordata: MuJoCo's latest sensor readings, shape (nsensordata,).
      motors: Motor values that the driver commands, left motor first, shape (2,).
      event: Whether the robot is in contact (or in the spot); False at the start.
      event_seconds: Time in contact (or in the spot) since the start of the episode in [s].
    """

    time: float
    pose: np.ndarray
    spot: np.ndarray
    sensordata: np.ndarray
    motors: np.ndarray
    event: bool
    event_seconds: float


@dataclasses.dataclass(frozen=True)
class Episode:
    """A robot at its start pose, and the driver that acts from there.

    Attributes:
      task: Name of a task of the domain "arena".
      driver: Description of the driver in a few words.
      trained: Whether the driver has been trained.
      batch: Batch of one robot.
      act: Function that returns the driver's motor values for the sensor signals.
      steps: Number of control steps in the episode; infinity for an episode without end.
      random: Random stream of the spot's places, for tasks in which it jumps.
    """

    task: str
    driver: str
    trained: bool
    batch: Robots
    act: Act
    steps: float
    random: np.random.Generator

    @classmethod
    def of_policy(cls, policies: Policies, robot: int, phase: str, seed: int) -> Episode:
        """Returns the episode that Gymnasium's `reset(seed=seed)` starts in the policies' task.

        Args:
          policies: Trained policies, one of which drives the robot.
          robot: Index of the policy that drives the robot.
          phase: "pre" for the untrained policy, "post" for the trained policy.
          seed: Seed of the start pose, and of the spot's places.

        Raises:
          InputError: there is no such policy, or a value is invalid.
        """
        check_seed(seed)
        act, task = policy_act(policies, robot, phase), policies.task
        batch, random = make_batch(task, 1), np.random.default_rng(seed)
        pose, spot = Start().draw(random, batch.dimensions)
        batch.place_spot(_ALONE, spot[None])
        batch.place(_ALONE, pose[None])
        steps = TASKS[task].time_limit / CONTROL_TIMESTEP
        return cls(task, f"PPO, policy {robot}", phase == "post", batch, act, steps, random)

    @property
    def seconds(self) -> float:
        """Duration in simulated seconds."""
        return self.steps * CONTROL_TIMESTEP

    def moments(self) -> Iterator[Moment]:
        """Simulates the episode and yields its moments; ends early if the simulation is unstable.

        An episode can be simulated only once.
        """
        batch, events, event = self.batch, 0, False
        spot_steps = TASKS[self.task].spot_steps
        for step in itertools.count():
            motors = self.act(batch.rules.state(batch.sensordata).astype(np.float32))
            yield Moment(
                step * CONTROL_TIMESTEP,
                batch.pose[0],
                batch.spot[0],
                batch.sensordata[0].copy(),
                motors[0],
                event,
                events * CONTROL_TIMESTEP,
            )
            if step >= self.steps:
                return
            if spot_steps and step and step % spot_steps == 0:
                batch.place_spot(_ALONE, random_spots(self.random, batch.dimensions, 1))
            batch.step(motors)
            if not batch.valid.all():
                return
            event = bool(batch.rules.event(batch.sensordata)[0])
            events += event


def policy_act(policies: Policies, robot: int, phase: str) -> Act:
    """Returns the function that acts by one policy, before ("pre") or after ("post") training.

    Raises:
      InputError: there is no such policy, or no such phase.
    """
    check_phase(phase)
    return functools.partial(policies.one(robot).act, trained=phase == "post")


def check_phase(phase: str) -> None:
    """Raises InputError where a phase is not one of `PHASES`."""
    if phase not in PHASES:
        raise InputError(f"the phase must be one of {', '.join(PHASES)}, got {phase!r}")


def check_seed(seed: int) -> None:
    """Raises InputError where a seed is out of range."""
    if not 0 <= seed < 2**63:
        raise InputError(f"the seed must lie in [0, 2^63), got {seed}")
