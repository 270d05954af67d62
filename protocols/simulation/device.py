"""Devices: where the robots of a cohort and their brains compute."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import torch

from ...tasks.batch import Robots
from ...tasks.kinematic import KinematicBatch
from ..agents.base import Agent
from ..errors import InputError
from ..experiment.budget import cohort_bytes
from ..experiment.plan import Plan

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
    from ...tasks.kinematic_tensors import TensorBatch

    assert isinstance(batch, KinematicBatch)  # checked by Experiment
    with torch.device(device):
        return TensorBatch(batch), make_agent()


def on_host(values: Any) -> np.ndarray:
    """Returns an array of NumPy with the values of an array or of a tensor of any device."""
    return values.cpu().numpy() if isinstance(values, torch.Tensor) else values


def check_device(plan: Plan) -> None:
    """Raises InputError if a plan's device is missing, too small, or not for its robots."""
    device = plan.experiment.device
    if device == HOST:
        return
    for condition in plan.conditions:
        if not condition.has_brain:
            raise InputError(
                f"only robots with a brain are simulated on {device}, not {condition.proposer}"
            )
    count = torch.cuda.device_count() if torch.cuda.is_available() else 0
    number = int(device.partition(":")[2] or 0)
    if number >= count:
        found = f"there are {count}" if count else "there is no GPU that PyTorch can use"
        raise InputError(f"there is no device {device}: {found}")
    free, _ = torch.cuda.mem_get_info(number)
    needed = max(cohort_bytes(plan.experiment, condition) for condition in plan.conditions)
    if needed > free:
        raise InputError(
            f"a cohort of {plan.experiment.cohort_size} robots would need about "
            f"{needed / 2**30:.1f} GiB of memory on {device}, which has {free / 2**30:.1f} GiB free"
        )
