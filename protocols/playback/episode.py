"""A robot driven from a start, moment by moment: a test of a life, or an episode of any task."""

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

# Answers what B robots sense, float32, shape (B, S), with motors in [-0.5, 0.5], shape (B, 2).
Act = Callable[[np.ndarray], np.ndarray]

PHASES = ("pre", "post")  # before and after training
_ALONE = np.array([0])  # the robot of a batch of one


@dataclasses.dataclass(frozen=True)
class Moment:
    """A robot at the start of a control step.

    Attributes:
      time: simulated seconds since the episode began.
      pose: x, y in metres and heading in radians, shape (3,).
      spot: x, y of its centre, in metres, shape (2,).
      sensordata: what MuJoCo last measured, shape (nsensordata,).
      motors: what the driver answers, left and right, shape (2,).
      event: whether the robot is in contact, or in the spot; never so at the start.
      event_seconds: how long it has been so, since the episode began.
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
    """A robot at its start, and who drives it from there.

    Attributes:
      task: of the table of tasks.
      driver: who drives, in words.
      trained: whether the driver has learnt before.
      batch: the robot, a batch of one.
      act: drives.
      steps: how many control steps it lasts; infinity for no end.
      random: the random stream that a spot that jumps is drawn from.
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
        """An episode of the policies' task: the one that Gymnasium's `reset(seed=seed)` starts.

        Args:
          policies: of which one drives.
          robot: its number.
          phase: "pre" or "post", the policy as it was born or as it was when trained.
          seed: of where robot and spot are placed.

        Raises:
          InputError: there is no such policy, or a value makes no sense.
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
        """How long it lasts, simulated."""
        return self.steps * CONTROL_TIMESTEP

    def moments(self) -> Iterator[Moment]:
        """Lives through the episode, once; ends early where the simulation becomes unstable."""
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
    """A policy of a robot's own, as it was born ("pre") or as it was when trained ("post").

    Raises:
      InputError: there is no such policy, or no such phase.
    """
    check_phase(phase)
    return functools.partial(policies.one(robot).act, trained=phase == "post")


def check_phase(phase: str) -> None:
    """Raises InputError where a phase is none that a driver is known in."""
    if phase not in PHASES:
        raise InputError(f"the phase must be one of {', '.join(PHASES)}, got {phase!r}")


def check_seed(seed: int) -> None:
    """Raises InputError where a seed makes no sense."""
    if not 0 <= seed < 2**63:
        raise InputError(f"the seed must lie in [0, 2^63), got {seed}")
