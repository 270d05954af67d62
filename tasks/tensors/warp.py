"""MuJoCo Warp on tensors of PyTorch."""

from __future__ import annotations

import numpy as np
import torch

from ..batch import Batch
from ..warp.robots import WarpBatch
from .capture import Captured
from .robots import TensorRobots


class WarpTensors(TensorRobots):
    """Robots in MuJoCo Warp as tensors on the default device, equal to those of a `WarpBatch`."""

    _MOTORS = torch.float64

    def __init__(self, batch: Batch) -> None:
        """Makes robots in the arena of a batch, at the origin."""
        batch = WarpBatch(batch.model, batch.rules, batch.robots)
        super().__init__(batch)
        self._warp = batch.warp
        self._motors = self._tensors["control"][:, : batch.model.nu]
        self._rest = self._constant(batch.arrays()["state"][0])
        self._before = Captured(self._load, self._device)
        self._after = Captured(self._read, self._device)

    def _advance(self) -> None:
        """See `TensorRobots._advance`."""
        self._before()
        self._warp.run()  # a graph of Warp's
        self._after()

    def _load(self) -> None:
        self._motors.copy_(self._commanded())
        self._warp.load(self._tensors["state"], self._tensors["control"])

    def _read(self) -> None:
        state = self._tensors["state"]
        self.sensordata.copy_(self._warp.read(state))
        unsound = self._unsound(state[:, 1:7])[:, None]
        state.copy_(self._rest.where(unsound, state))
        self._motors.masked_fill_(unsound, 0.0)

    def stop(self, robots: np.ndarray) -> None:
        """See `Robots.stop`.

        Raises:
          CapacityError: See `WarpEngine.check_capacity`.
        """
        self._warp.check_capacity()
        super().stop(robots)
