"""Devices: where the robots of a cohort and their brains compute."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import torch

from ...tasks.batch import Batch, Robots
from ...tasks.kinematic.robots import KinematicBatch
from ..agents.base import Agent
from ..experiment.experiment import Experiment


def robots_on_device(
    experiment: Experiment, task: str, make_agent: Callable[[], Agent]
) -> tuple[Robots, Agent]:
    """Returns the robots of a cohort and their new agent on the experiment's device.

    Args:
      experiment: Experiment that decides the robots' lives.
      task: Task of the protocol.
      make_agent: Function that makes the agent.
    """
    batch = experiment.batch(task, experiment.cohort_size)
    if not experiment.on_tensors:
        return batch, make_agent()
    with torch.device(experiment.device):
        return on_tensors(batch), make_agent()


def on_tensors(batch: Robots) -> Robots:
    """Returns the robots of a batch as tensors on the default device; from MuJoCo, in Warp."""
    if isinstance(batch, KinematicBatch):
        from ...tasks.tensors.kinematic import KinematicTensors

        return KinematicTensors(batch)
    from ...tasks.tensors.warp import WarpTensors

    assert isinstance(batch, Batch)
    return WarpTensors(batch)


def on_host(values: Any) -> np.ndarray:
    """Returns an array of NumPy with the values of an array or of a tensor of any device."""
    return values.cpu().numpy() if isinstance(values, torch.Tensor) else values
