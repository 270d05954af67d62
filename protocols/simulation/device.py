"""Devices: where the robots of a cohort and their brains compute, and how a GPU repeats a step."""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import Any

import numpy as np
import torch
from torch import Tensor

from ...models.arrays import namespace
from ...tasks.batch import Batch, Robots
from ...tasks.kinematic.robots import KinematicBatch
from ...tasks.tensors import recording
from ...tasks.tensors.parts import Part, parts
from ...tasks.tensors.robots import TensorRobots
from ..agents.base import Agent
from ..agents.neurocontroller import NeurocontrollerAgent
from ..experiment.experiment import Experiment

HOST = "cpu"


def robots_on_device(experiment: Experiment, task: str, cohorts: int = 1) -> list[Robots]:
    """Returns the robots of some cohorts, at the origin, on the experiment's device.

    Args:
      experiment: Experiment that decides the robots' lives.
      task: Task of the protocol.
      cohorts: Number of cohorts; several are parts of one batch (see `tasks.tensors.parts`), for
        robots on tensors only.
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
        from ...tasks.tensors.kinematic import KinematicTensors

        return KinematicTensors(batch)
    from ...tasks.tensors.warp import WarpTensors

    assert isinstance(batch, Batch)
    return WarpTensors(batch)


class Steps:
    """What a cohort does in a control step besides the physics: it decides, and counts events."""

    def __init__(self, agent: Agent, batch: Robots) -> None:
        """Takes the agent, and the robots that it drives."""
        self._agent = agent
        self._batch = batch
        self._tally: Any = 0

    def decide(self, learning: bool, fresh: bool) -> Any:
        """Lets the agent act and, in training, learn; returns motor values, shape (B, 2).

        Args:
          learning: Whether the agent explores and learns.
          fresh: Whether this is one of the first two steps of its kind.
        """
        del fresh
        rules, sensordata = self._batch.rules, self._batch.sensordata
        motors = self._agent.act(_single(rules.state(sensordata)), learning)
        if learning:
            self._agent.learn(_single(rules.reward(sensordata)))
        return motors

    def count(self) -> None:
        """Counts the events after a step of the physics."""
        self._tally = self._tally + self._batch.rules.event(self._batch.sensordata)

    def counted(self) -> np.ndarray:
        """Returns how many events were counted since the last call, shape (B,)."""
        tally, self._tally = self._tally, 0
        return on_host(tally)


class RecordedSteps(Steps):
    """Steps of a brain on a GPU that are recorded once and then replayed.

    There is a recording of each kind of step, training or test, and for each of the two alternating
    memories of a brain. The first two steps of a kind are done directly: whether a brain knows the
    reward of the step before is decided on the host.
    """

    def __init__(self, agent: NeurocontrollerAgent, batch: TensorRobots | Part) -> None:
        """Takes the agent, and the robots that it drives."""
        super().__init__(agent, batch)
        self._brain = agent.controller
        self._recordings: dict[tuple[bool, bool], tuple[recording.Work, Any]] = {}
        device = batch.sensordata.device
        self._tally = torch.zeros(batch.robots, dtype=torch.int32, device=device)
        self._count = recording.Recorded(self._add_events, device)

    def decide(self, learning: bool, fresh: bool) -> Any:
        """See `Steps.decide`; the motor values are valid until the next step but one."""
        if fresh:
            return super().decide(learning, fresh)
        kind = learning, self._brain.begin()
        if kind not in self._recordings:
            work = functools.partial(self._select, learning)
            self._recordings[kind] = recording.record(work, self._brain.generator)
        replay, motors = self._recordings[kind]
        replay()
        if learning:
            self._brain.end()
        return motors

    def count(self) -> None:
        """See `Steps.count`."""
        self._count()

    def counted(self) -> np.ndarray:
        """See `Steps.counted`."""
        counted = self._tally.cpu().numpy().copy()
        self._tally.zero_()
        return counted

    @torch.inference_mode()
    def _select(self, learning: bool) -> Tensor:
        rules, sensordata = self._batch.rules, self._batch.sensordata
        motors = self._brain.select(_single(rules.state(sensordata)), learning)
        if learning:
            self._brain.update(_single(rules.reward(sensordata)))
        return motors

    def _add_events(self) -> None:
        self._tally += self._batch.rules.event(self._batch.sensordata)


def steps_on_device(agent: Agent, batch: Robots) -> Steps:
    """Returns the steps of a cohort, recorded where its device can do that."""
    if isinstance(batch, TensorRobots | Part) and isinstance(agent, NeurocontrollerAgent):
        if recording.records(batch.sensordata.device):
            return RecordedSteps(agent, batch)
    return Steps(agent, batch)


def _single(values: Any) -> Any:
    """Returns values in single precision, in which brains compute."""
    xp = namespace(values)
    return xp.astype(values, xp.float32)


def on_host(values: Any) -> np.ndarray:
    """Returns a NumPy array, copied to the host if the values are a tensor."""
    return values.cpu().numpy() if isinstance(values, torch.Tensor) else values
