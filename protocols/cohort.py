"""A cohort: robots that live in lockstep, each alone in its arena, from birth to last test."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from typing import Any

import numpy as np
import torch

from ..controller import Neurocontroller
from ..tasks import make_batch
from ..tasks.arena import random_poses, random_spots
from .experiment import CohortKey, Experiment
from .schedules import Phase, Schedule, control_steps

PARTS = ("pre", "training", "post")
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
        self.batch = make_batch(key.task, robots, nose=experiment.nose)
        self.rules = self.batch.rules
        sensors = self.rules.state(self.batch.sensordata).shape[1]
        self.brain = Neurocontroller(experiment.brain, key.proposer, robots, sensors, seed)
        self._before = {k: v.clone() for k, v in self.brain.networks().items()}
        self._legs = legs(experiment.schedule(key.task))
        self.step = 0
        self.steps = self._legs[-1].stop
        self._events = np.zeros((robots, len(PARTS)), dtype=np.int32)
        self._minutes = np.zeros((robots, -(-self.steps // _MINUTE)), dtype=np.int16)

    @property
    def finished(self) -> bool:
        """Whether the last test is over."""
        return self.step == self.steps

    @torch.inference_mode()
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
        everyone = np.arange(self.batch.robots)
        if phase.spot is not None:
            spots = (
                random_spots(self._random, self.batch.dimensions, len(everyone))
                if phase.spot == "random"
                else np.tile(phase.spot, (len(everyone), 1))
            )
            self.batch.place_spot(everyone, spots)
        if phase.robot is not None:
            poses = (
                random_poses(self._random, self.batch.dimensions, len(everyone))
                if phase.robot == "random"
                else np.tile(phase.robot, (len(everyone), 1))
            )
            self.batch.place(everyone, poses)
            if not self._experiment.learn_across_placement:
                self.brain.forget_step()

    def _live(self, phase: Phase, until: int) -> None:
        batch, rules, brain = self.batch, self.rules, self.brain
        events = self._events[:, PARTS.index(phase.part)]
        while self.step < until:
            motors = brain.act(_tensor(rules.state(batch.sensordata)), explore=phase.learning)
            if phase.learning:
                brain.learn(_tensor(rules.reward(batch.sensordata)))
            batch.step(motors.numpy())
            event = rules.event(batch.sensordata)
            events += event
            self._minutes[:, self.step // _MINUTE] += event
            self.step += 1
            if self.step % _MINUTE == 0:
                batch.stop(~brain.finite().numpy())

    def lives(self) -> Lives:
        """What the cohort leaves, once it is finished."""
        return Lives(
            self._events,
            self._minutes,
            self.batch.valid,
            {k: v.numpy() for k, v in self._before.items()},
            {k: v.numpy() for k, v in self.brain.networks().items()},
        )

    def checkpoint(self) -> tuple[dict[str, np.ndarray], dict[str, Any]]:
        """Arrays and JSON notes from which `restore` goes on to the same bits."""
        arrays = {
            "events": self._events,
            "minutes": self._minutes,
            **{f"before.{k}": v.numpy() for k, v in self._before.items()},
            **{f"brain.{k}": v.numpy() for k, v in self.brain.state().items()},
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
        self.brain.load_state({k: torch.from_numpy(v) for k, v in groups["brain"].items()})
        for name, tensor in self._before.items():
            tensor.copy_(torch.from_numpy(groups["before"][name]))
        self._events[:] = arrays["events"]
        self._minutes[:] = arrays["minutes"]
        self._random.bit_generator.state = notes["random"]
        self.step = notes["step"]


def _tensor(array: np.ndarray) -> torch.Tensor:
    return torch.from_numpy(array.astype(np.float32))
