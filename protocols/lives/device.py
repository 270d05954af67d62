"""Devices: where the robots of a cohort and their brains compute, and how a GPU repeats a step."""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np
import torch

from ...models.arrays import namespace
from ...tasks.batch import Batch, Robots
from ...tasks.kinematic import KinematicBatch
from ...tasks.tensors import capture
from ...tasks.tensors.robots import KinematicTensors, Part, TensorRobots, parts
from ..agents.base import Agent
from ..agents.neurocontroller import NeurocontrollerAgent
from .experiment import Experiment

if TYPE_CHECKING:
    from .cohort import Cohort

HOST = "cpu"


def robots_on_device(experiment: Experiment, task: str, cohorts: int = 1) -> list[Robots]:
    """Returns the robots of some cohorts, at the origin, on the experiment's device.

    Args:
      experiment: Experiment that decides the robots' lives.
      task: Task of the protocol.
      cohorts: Number of cohorts; several are parts of one batch, for robots on tensors only (see
        `tasks.tensors.robots.parts`).
    """
    batch = experiment.batch(task, cohorts * experiment.cohort_size)
    if not experiment.on_tensors:
        return [batch]
    with torch.device(experiment.device):
        tensors = on_tensors(batch)
    return [tensors] if cohorts == 1 else [*parts(tensors, cohorts)]


def agent_on_device(experiment: Experiment, make_agent: Callable[[], Agent]) -> Agent:
    """Returns a new agent whose tensors are on the experiment's device."""
    if not experiment.on_tensors:
        return make_agent()
    with torch.device(experiment.device):
        return make_agent()


def on_tensors(batch: Robots) -> TensorRobots:
    """Returns a batch's robots as tensors on the default device; MuJoCo's are simulated in Warp."""
    if isinstance(batch, KinematicBatch):
        return KinematicTensors(batch)
    from ...tasks.tensors.warp import WarpTensors

    assert isinstance(batch, Batch)
    return WarpTensors(batch)


class StepWork:
    """What a cohort does in a control step besides the physics: it decides, and counts events."""

    def __init__(self, agent: Agent, batch: Any) -> None:
        """Takes an agent, and the robots that it drives, of any kind."""
        self._agent, self._batch = agent, batch
        self._tally: Any = 0

    def decide(self, learning: bool) -> Any:
        """Lets the agent act and, in training, learn; returns motor values, shape (B, 2).

        Args:
          learning: Whether the agent explores and learns.
        """
        agent, batch = self._agent, self._batch
        motors = agent.act(_single(batch.rules.state(batch.sensordata)), learning)
        if learning:
            agent.learn(_single(batch.rules.reward(batch.sensordata)))
        return motors

    def count(self) -> None:
        """Counts the events after a step of the physics."""
        self._tally = self._tally + self._batch.rules.event(self._batch.sensordata)

    def counted(self) -> np.ndarray:
        """Returns how many events were counted since the last call, shape (B,)."""
        tally, self._tally = self._tally, 0
        return on_host(tally)


class CapturedWork(StepWork):
    """The work of a brain on a GPU, captured once and then replayed.

    Training and tests are captured separately, and each for both places in which a brain remembers
    alternate steps.
    """

    def __init__(self, agent: Agent, batch: Any) -> None:
        """Takes an agent that is a brain, and robots that are tensors."""
        super().__init__(agent, batch)
        assert isinstance(agent, NeurocontrollerAgent)
        self._brain = agent.controller
        device, robots = self._batch.sensordata.device, self._batch.robots
        self._motors = torch.zeros(robots, 2, device=device)
        self._tally = torch.zeros(robots, dtype=torch.int32, device=device)
        self._count = capture.Captured(self._add_events, device)
        self._decide = {
            (learning, place): capture.Captured(
                functools.partial(self._select, learning), device, self._brain.generator
            )
            for learning in (False, True)
            for place in (False, True)
        }

    def decide(self, learning: bool) -> Any:
        """See `StepWork.decide`; the motor values are overwritten by the next step."""
        self._decide[learning, self._brain.begin()]()
        if learning:
            self._brain.end()
        return self._motors

    def count(self) -> None:
        """See `StepWork.count`."""
        self._count()

    def counted(self) -> np.ndarray:
        """See `StepWork.counted`."""
        counted = self._tally.cpu().numpy().copy()
        self._tally.zero_()
        return counted

    @torch.inference_mode()
    def _select(self, learning: bool) -> None:
        rules, sensordata = self._batch.rules, self._batch.sensordata
        self._motors.copy_(self._brain.select(_single(rules.state(sensordata)), learning))
        if learning:
            self._brain.update(_single(rules.reward(sensordata)))

    def _add_events(self) -> None:
        self._tally += self._batch.rules.event(self._batch.sensordata)


def step_work(cohort: Cohort) -> StepWork:
    """Returns the work of a cohort, captured where its device can do that."""
    batch = cohort.batch
    on_tensors = isinstance(batch, TensorRobots | Part)
    is_brain = type(cohort.agent) is NeurocontrollerAgent  # a subclass may act otherwise
    if on_tensors and is_brain and capture.captures(batch.sensordata.device):
        return CapturedWork(cohort.agent, batch)
    return StepWork(cohort.agent, batch)


def _single(values: Any) -> Any:
    """Returns values in single precision, in which brains compute."""
    xp = namespace(values)
    return xp.astype(values, xp.float32)


def on_host(values: Any) -> np.ndarray:
    """Returns a NumPy array, copied to the host if the values are a tensor."""
    return values.cpu().numpy() if isinstance(values, torch.Tensor) else values
