"""Devices: where the robots of a cohort and their brains compute."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import torch

from ...tasks.batch import Robots
from ...tasks.kinematic.robots import KinematicBatch
from ..agents.base import Agent

HOST = "cpu"


def robots_on(device: str, batch: Robots, make_agent: Callable[[], Agent]) -> tuple[Robots, Agent]:
    """Returns robots and their new agent on a device.

    Args:
      device: Device of the experiment; on the host, the robots are those given.
      batch: Robots on the host.
      make_agent: Function that makes the agent.
    """
    if device == HOST:
        return batch, make_agent()
    from ...tasks.kinematic.tensors import TensorBatch

    assert isinstance(batch, KinematicBatch)  # checked by Experiment
    with torch.device(device):
        return TensorBatch(batch), make_agent()


def on_host(values: Any) -> np.ndarray:
    """Returns an array of NumPy with the values of an array or of a tensor of any device."""
    return values.cpu().numpy() if isinstance(values, torch.Tensor) else values
