"""Devices: where the robots of a cohort and their brains compute."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import torch

from ...tasks.batch import Batch, Robots
from ...tasks.kinematic.robots import KinematicBatch
from ...tasks.tensors.parts import parts
from ...tasks.tensors.robots import TensorRobots
from ..agents.base import Agent
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


def on_host(values: Any) -> np.ndarray:
    """Returns a NumPy array, copied to the host if the values are a tensor."""
    return values.cpu().numpy() if isinstance(values, torch.Tensor) else values
