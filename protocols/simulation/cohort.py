"""A cohort: robots that live in lockstep, each alone in its arena, from birth to last test."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from typing import Any

import numpy as np

from ...controller import PROPOSERS
from ...tasks.batch import Robots
from ...tasks.starts import random_poses, random_spots
from ..agents.base import make_agent
from ..errors import InputError
from ..experiment.experiment import CohortKey, Experiment, Plan
from ..experiment.schedules import PARTS, Phase, Schedule, control_steps

_MINUTE = control_steps(1)


@dataclasses.dataclass(frozen=True)
class Leg:
    """A stretch of a life between two placements: control steps `start` to `stop`."""

    start: int
    stop: int
    phase: Phase


def legs(schedule: Schedule) -> list[Leg]:
    """Cuts a schedule's phases at every placement."""
    result = []
    now = 0
    for phase, length in zip(schedule.phases, schedule.steps(), strict=True):
        end = now + length
        stride = control_steps(phase.every_minutes) if phase.every_minutes else length
        while now < end:
            result.append(Leg(now, min(now + stride, end), phase))
            now = result[-1].stop
    return result


def place(batch: Robots, phase: Phase, random: np.random.Generator) -> None:
    """Puts robots and spots where a phase begins; the spots first, so that they are smelled.

    Args:
      batch: the robots.
      phase: which.
      random: to draw the places from that the phase leaves to chance.
    """
    everyone = np.arange(batch.robots)
    if phase.spot == "random":
        batch.place_spot(everyone, random_spots(random, batch.dimensions, batch.robots))
    elif phase.spot is not None:
        batch.place_spot(everyone, np.tile(phase.spot, (batch.robots, 1)))
    if phase.robot == "random":
        batch.place(everyone, random_poses(random, batch.dimensions, batch.robots))
    elif phase.robot is not None:
        batch.place(everyone, np.tile(phase.robot, (batch.robots, 1)))


def check_births(plan: Plan) -> None:
    """Gives birth to a cohort of every agent of a user's, and lets it act once.

    Raises:
      InputError: there is no such agent, it is none, or it answers with no motors.
    """
    robots = plan.experiment.cohort_size
    for task, proposer in plan.conditions:
        if proposer in PROPOSERS:
            continue
        cohort = Cohort(plan.experiment, CohortKey(task, proposer, 0))
        cohort.agent.reset()
        state = cohort.rules.state(cohort.batch.sensordata).astype(np.float32)
        shape = np.shape(cohort.agent.act(state, False))
        if shape != (robots, 2):
            raise InputError(f"{proposer} must act with motors of shape ({robots}, 2), got {shape}")
        cohort.checkpoint()


@dataclasses.dataclass(frozen=True)
class Lives:
    """What a finished cohort leaves.

    Attributes:
      events: control steps in contact, or in the spot, before, in and after training, shape
        (B, 3).
      minutes: the same for each simulated minute, shape (B, M).
      valid: False where the simulation became unstable, shape (B,).
      before: networks at birth, each of shape (B, ...).
      after: networks after training.
    """

    events: np.ndarray
    minutes: np.ndarray
    valid: np.ndarray
    before: dict[str, np.ndarray]
    after: dict[str, np.ndarray]


class Cohort:
    """B robots on their way through a schedule.

    Attributes:
      step: control steps lived.
      steps: control steps of a whole life.
    """

    def __init__(self, experiment: Experiment, key: CohortKey) -> None:
        """Gives birth to a cohort; nothing has been lived yet."""
        robots = experiment.cohort_size
        seed, self._random = experiment.seeds(key)
        self._experiment = experiment
        self.batch = experiment.batch(key.task, robots)
        self.rules = self.batch.rules
        self.agent = make_agent(experiment, key.task, key.proposer, robots, seed)
        self._before = {k: v.copy() for k, v in self.agent.weights().items()}
        self._legs = legs(experiment.schedule(key.task))
        self.step = 0
        self.steps = self._legs[-1].stop
        self._events = np.zeros((robots, len(PARTS)), dtype=np.int32)
        self._minutes = np.zeros((robots, -(-self.steps // _MINUTE)), dtype=np.int16)

    @property
    def finished(self) -> bool:
        """Whether the last test is over."""
        return self.step == self.steps

    def advance(self, steps: int) -> None:
        """Lives up to so many more control steps."""
        until = min(self.step + steps, self.steps)
        for leg in self._legs:
            if leg.stop <= self.step:
                continue
            if leg.start >= until:
                break
            if leg.start == self.step:
                self._place(leg.phase)
            self._live(leg.phase, min(leg.stop, until))

    def _place(self, phase: Phase) -> None:
        place(self.batch, phase, self._random)
        if phase.robot is not None:
            self.agent.reset()

    def _live(self, phase: Phase, until: int) -> None:
        batch, rules, agent = self.batch, self.rules, self.agent
        events = self._events[:, PARTS.index(phase.part)]
        while self.step < until:
            motors = agent.act(rules.state(batch.sensordata).astype(np.float32), phase.learning)
            if phase.learning:
                agent.learn(rules.reward(batch.sensordata).astype(np.float32))
            batch.step(motors)
            event = rules.event(batch.sensordata)
            events += event
            self._minutes[:, self.step // _MINUTE] += event
            self.step += 1
            if self.step % _MINUTE == 0:
                for weights in agent.weights().values():
                    finite = np.isfinite(weights).reshape(batch.robots, -1)
                    batch.stop(np.flatnonzero(~finite.all(axis=1)))

    def lives(self) -> Lives:
        """What the cohort leaves, once it is finished."""
        return Lives(
            self._events,
            self._minutes,
            self.batch.valid,
            self._before,
            {k: v.copy() for k, v in self.agent.weights().items()},
        )

    def checkpoint(self) -> tuple[dict[str, np.ndarray], dict[str, Any]]:
        """Arrays and JSON notes from which `restore` goes on to the same bits."""
        arrays = {
            "events": self._events,
            "minutes": self._minutes,
            **{f"before.{k}": v for k, v in self._before.items()},
            **{f"brain.{k}": v for k, v in self.agent.state().items()},
            **{f"batch.{k}": v for k, v in self.batch.arrays().items()},
        }
        return arrays, {"step": self.step, "random": self._random.bit_generator.state}

    def restore(self, arrays: Mapping[str, np.ndarray], notes: Mapping[str, Any]) -> None:
        """Goes on from a checkpoint of the same cohort.

        Raises:
          ValueError: an array is missing, or its shape is another.
        """
        groups: dict[str, dict[str, Any]] = {"before": {}, "brain": {}, "batch": {}}
        for name, array in arrays.items():
            group, _, rest = name.partition(".")
            if rest:
                groups[group][rest] = array
        if not 0 <= notes["step"] <= self.steps:
            raise ValueError(f"step must lie in [0, {self.steps}], got {notes['step']}")
        self.batch.load_arrays(groups["batch"])
        self.agent.load_state(groups["brain"])
        for name, weights in self._before.items():
            weights[:] = groups["before"][name]
        self._events[:] = arrays["events"]
        self._minutes[:] = arrays["minutes"]
        self._random.bit_generator.state = notes["random"]
        self.step = notes["step"]
