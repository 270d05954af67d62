"""Devices that compute robots and brains, and CUDA graphs that replay control steps on a GPU."""

from __future__ import annotations

import contextlib
import functools
from typing import Any

import numpy as np
import torch

from ...controller import Neurocontroller
from ...models.arrays import namespace
from ...tasks.batch import Batch, Robots
from ...tasks.kinematic import KinematicBatch
from ...tasks.tensors import capture
from ...tasks.tensors.robots import KinematicTensors
from ..agents.base import Agent
from ..agents.neurocontroller import NeurocontrollerAgent
from .experiment import Experiment


def device_of(experiment: Experiment) -> contextlib.AbstractContextManager[Any]:
    """Returns a context in which new tensors are on the experiment's device."""
    return torch.device(experiment.device) if experiment.on_tensors else contextlib.nullcontext()


def robots_on_device(experiment: Experiment, task: str) -> Robots:
    """Returns the robots of a cohort, at the origin, on the experiment's device."""
    batch = experiment.batch(task, experiment.cohort_size)
    if not experiment.on_tensors:
        return batch
    with device_of(experiment):
        if isinstance(batch, KinematicBatch):
            return KinematicTensors(batch)
        from ...tasks.tensors.warp import WarpTensors

        assert isinstance(batch, Batch)
        return WarpTensors(batch)


def decide(agent: Agent, batch: Robots, learning: bool) -> Any:
    """Lets an agent act and, if `learning`, explore and learn from the previous step.

    Returns:
      Motor values for the next control step, shape (B, 2).
    """
    rules, sensordata = batch.rules, batch.sensordata
    motors = agent.act(_single(rules.state(sensordata)), learning)
    if learning:
        agent.learn(_single(rules.reward(sensordata)))
    return motors


def _single(values: Any) -> Any:
    """Returns values in single precision, in which brains compute."""
    if isinstance(values, torch.Tensor):
        return values.to(torch.float32, copy=True)
    return values.astype(np.float32)


def on_host(values: Any) -> np.ndarray:
    """Returns a NumPy array, copied to the host if the values are a tensor."""
    return values.cpu().numpy() if isinstance(values, torch.Tensor) else values


def zero_counts(batch: Robots) -> Any:
    """Returns a count of 0 for each robot on the robots' device, int32, shape (B,)."""
    xp = namespace(batch.sensordata)
    return xp.zeros(batch.robots, dtype=xp.int32, device=batch.sensordata.device)


def add_events(batch: Robots, counts: Any) -> None:
    """Adds 1 to `counts`, shape (B,), for each robot with the measured event, such as contact."""
    counts += batch.rules.event(batch.sensordata)


class CapturedSteps:
    """Control steps on a GPU without the physics: captured as CUDA graphs, then replayed.

    Training and tests have separate graphs. Each has two, because a brain stores successive steps
    alternately in two places.

    Attributes:
      count: Function to call after the physics of a step; it calls `add_events` for the robots.
    """

    def __init__(self, brain: Neurocontroller, batch: Robots, counts: torch.Tensor) -> None:
        """Prepares the graphs; the first calls do their work directly, without capture.

        Args:
          brain: Brains of the B robots, on a GPU.
          batch: Robots whose sensor data are tensors on the brains' device.
          counts: Each robot's number of control steps with the measured event since the last
            `Cohort.store`, shape (B,). Each step adds to it in place.
        """
        device, random = counts.device, brain.generator
        self._brain = brain
        self._motors = torch.zeros(batch.robots, 2, device=device)
        self._steps = {
            (learning, place): capture.Captured(
                functools.partial(_decide, brain, batch, self._motors, learning), device, random
            )
            for learning in (False, True)
            for place in (False, True)
        }
        self.count = capture.Captured(functools.partial(add_events, batch, counts), device)

    def decide(self, learning: bool) -> torch.Tensor:
        """Decides as `device.decide` does; the next call overwrites the returned motor values."""
        self._steps[learning, self._brain.begin()]()
        if learning:
            self._brain.end()
        return self._motors


@torch.inference_mode()
def _decide(brain: Neurocontroller, batch: Robots, motors: torch.Tensor, learning: bool) -> None:
    rules, sensordata = batch.rules, batch.sensordata
    motors.copy_(brain.select(_single(rules.state(sensordata)), learning))
    if learning:
        brain.update(_single(rules.reward(sensordata)))


def captured_steps(agent: Agent, batch: Robots, counts: Any) -> CapturedSteps | None:
    """Returns the `CapturedSteps` of a brain on a GPU; None for other agents and devices."""
    is_brain = type(agent) is NeurocontrollerAgent  # a subclass may act otherwise
    if is_brain and isinstance(counts, torch.Tensor) and capture.captures(counts.device):
        return CapturedSteps(agent.controller, batch, counts)
    return None
