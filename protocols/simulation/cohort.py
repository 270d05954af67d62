"""A cohort: robots simulated in lockstep, each alone in its arena, from the first test on."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from ..agents.factory import make_agent
from ..errors import InputError
from ..experiment.conditions import CohortKey
from ..experiment.experiment import Experiment
from ..experiment.plan import Plan
from ..experiment.random_streams import random_streams
from ..experiment.schedules import PARTS, Phase, control_steps
from ..results.results import Lives
from .placement import legs, place

_MINUTE = control_steps(1)


class Cohort:
    """B robots that follow a schedule.

    Attributes:
      batch: Robots in their arenas.
      rules: Observations, reward and event of the task.
      agent: Agent that drives the robots.
      step: Number of control steps simulated so far.
      steps: Number of control steps of a whole life.
    """

    def __init__(self, experiment: Experiment, key: CohortKey) -> None:
        """Makes robots at the start of their lives.

        Args:
          experiment: Experiment that decides the robots' lives.
          key: Condition and number of the cohort.
        """
        robots, task = experiment.cohort_size, key.condition.task
        seed, self._random = random_streams(experiment.seed, key)
        self.batch = experiment.batch(task, robots)
        self.rules = self.batch.rules
        self.agent = make_agent(experiment, key.condition, robots, seed)
        self._before = {k: v.copy() for k, v in self.agent.weights().items()}
        self._legs = legs(experiment.schedule(task))
        self.step = 0
        self.steps = self._legs[-1].stop
        self._events = np.zeros((robots, len(PARTS)), dtype=np.int32)
        self._minutes = np.zeros((robots, -(-self.steps // _MINUTE)), dtype=np.int16)

    @property
    def finished(self) -> bool:
        """Whether the last test is over."""
        return self.step == self.steps

    def advance(self, steps: int) -> None:
        """Simulates the given number of control steps, or fewer if the life ends before."""
        until = min(self.step + steps, self.steps)
        for leg in self._legs:
            if leg.stop <= self.step:
                continue
            if leg.start >= until:
                break
            if leg.start == self.step:
                self._place(leg.phase)
            self._simulate(leg.phase, min(leg.stop, until))

    def _place(self, phase: Phase) -> None:
        place(self.batch, phase, self._random)
        if phase.robot is not None:
            self.agent.reset()

    def _simulate(self, phase: Phase, until: int) -> None:
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
        """Returns the results of the finished cohort."""
        return Lives(
            self._events,
            self._minutes,
            self.batch.valid,
            self._before,
            {k: v.copy() for k, v in self.agent.weights().items()},
        )

    def checkpoint(self) -> tuple[dict[str, np.ndarray], dict[str, Any]]:
        """Returns arrays and JSON notes from which `restore` continues bit-exactly."""
        arrays = {
            "events": self._events,
            "minutes": self._minutes,
            **{f"before.{k}": v for k, v in self._before.items()},
            **{f"brain.{k}": v for k, v in self.agent.state().items()},
            **{f"batch.{k}": v for k, v in self.batch.arrays().items()},
        }
        return arrays, {"step": self.step, "random": self._random.bit_generator.state}

    def restore(self, arrays: Mapping[str, np.ndarray], notes: Mapping[str, Any]) -> None:
        """Continues from a checkpoint of the same cohort.

        Args:
          arrays: Arrays that `checkpoint` returned.
          notes: JSON notes that `checkpoint` returned.

        Raises:
          KeyError, ValueError: an array is missing, or its shape differs.
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


def check_agents(plan: Plan) -> None:
    """Makes a cohort of every user's agent in a plan and lets the agent act once.

    Raises:
      InputError: there is no such agent, or it does not return motor values.
    """
    robots = plan.experiment.cohort_size
    for condition in plan.conditions:
        if condition.has_brain:
            continue
        cohort = Cohort(plan.experiment, CohortKey(condition, 0))
        cohort.agent.reset()
        state = cohort.rules.state(cohort.batch.sensordata).astype(np.float32)
        shape = np.shape(cohort.agent.act(state, False))
        if shape != (robots, 2):
            raise InputError(
                f"{condition.proposer} must return motor values of shape ({robots}, 2), got {shape}"
            )
        cohort.checkpoint()
