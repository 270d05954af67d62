"""The kinematic simulator on tensors of PyTorch."""

from __future__ import annotations

from typing import Any

import numpy as np
import torch

from ..kinematic.robots import KinematicBatch, after_control_step, measure
from .capture import Captured
from .robots import TensorRobots


class KinematicTensors(TensorRobots):
    """The robots of a `KinematicBatch`, as tensors on the default device.

    The equations are those of the `KinematicBatch`; numbers differ from its numbers by rounding.
    """

    _MOTORS = torch.float32

    def __init__(self, batch: KinematicBatch) -> None:
        """Takes over the robots of a batch, which is not to be used any more."""
        super().__init__(batch)
        self._kinematics = batch.kinematics
        self._gains = self._constant(np.array(batch.dimensions.gains, dtype=np.float32))
        self._simulate = Captured(self._simulated, self._device)

    def _advance(self) -> None:
        """See `TensorRobots._advance`."""
        self._simulate()

    def _simulated(self) -> None:
        own = self._tensors
        motors: Any = self._commanded() * self._gains
        poses, wheels, contact = after_control_step(
            own["poses"], own["wheels"], motors, self._kinematics, self.dimensions
        )
        own["poses"].copy_(poses)
        own["wheels"].copy_(wheels)
        own["touch"].copy_(contact)
        world = own["poses"], own["spots"], own["touch"]
        measure(self.sensordata, self.rules.layout, world, self.dimensions)
        unsound = self._unsound(own["poses"][:, :2])
        own["poses"].masked_fill_(unsound[:, None], 0.0)
        own["wheels"].masked_fill_(unsound[:, None], 0.0)
        own["touch"].masked_fill_(unsound, 0.0)
