"""The kinematic simulator on tensors of PyTorch, for populations on a GPU."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import torch
from torch import Tensor

from ..batch import Robots
from .robots import KinematicBatch, after_control_step, measure


class TensorBatch(Robots):
    """The robots of a `KinematicBatch`, as tensors on the default device.

    `step` takes motors as a tensor of shape (B, 2), and `sensordata` and `valid` are tensors. A
    step copies nothing between the device and the host, and waits for no number. Placements, states
    and checkpoints are arrays of NumPy, as of other batches. The equations are those of the
    `KinematicBatch`; numbers differ from its numbers by rounding.
    """

    def __init__(self, batch: KinematicBatch) -> None:
        """Takes over the robots of a batch, which is not to be used any more."""
        super().__init__(batch.robots, batch.rules, batch.dimensions, batch.sensordata.shape[1])
        self._host = batch
        self._kinematics = batch.kinematics
        device = torch.get_default_device()
        gains, bounds = batch.dimensions.gains, batch.dimensions.bounds[:2]
        self._gains = torch.tensor(gains, dtype=torch.float32, device=device)
        self._bounds = torch.tensor(bounds, dtype=torch.float64, device=device)
        self._tensors: dict[str, Any] = {  # of tensors
            name: torch.from_numpy(array.copy()).to(device)
            for name, array in batch.arrays().items()
        }
        self.sensordata: Any = self._tensors["sensordata"]
        self.valid: Any = self._tensors["valid"]

    @property
    def pose(self) -> np.ndarray:
        """See `Robots.pose`."""
        return self.arrays()["poses"]

    @property
    def spot(self) -> np.ndarray:
        """See `Robots.spot`."""
        return self.arrays()["spots"]

    def place(self, robots: np.ndarray, poses: np.ndarray) -> None:
        """See `Robots.place`."""
        self._fetch()
        self._host.place(robots, poses)
        self._send()

    def place_spot(self, robots: np.ndarray, spots: np.ndarray) -> None:
        """See `Robots.place_spot`."""
        self._fetch()
        self._host.place_spot(robots, spots)
        self._send()

    def stop(self, robots: np.ndarray) -> None:
        """See `Robots.stop`."""
        if np.size(robots):
            self._fetch()
            self._host.stop(robots)
            self._send()

    def step(self, motors: Any) -> None:
        """Simulates a control step of 0.1 s.

        Args:
          motors: Motor values, left and right, shape (B, 2). Values beyond [-0.5, 0.5] are
            clipped; a robot whose values are not finite becomes invalid.

        Raises:
          ValueError: the motors have another shape.
        """
        if motors.shape != (self.robots, 2):
            shape = self.robots, 2
            raise ValueError(f"motors must have shape {shape}, got {tuple(motors.shape)}")
        own, valid = self._tensors, self.valid
        valid &= motors.isfinite().all(dim=1)
        motors = torch.where(valid[:, None], motors, 0.0).clamp(-0.5, 0.5) * self._gains
        poses, wheels, contact = after_control_step(
            own["poses"], own["wheels"], motors, self._kinematics, self.dimensions
        )
        own["poses"].copy_(poses)
        own["wheels"].copy_(wheels)
        own["touch"].copy_(contact)
        world = own["poses"], own["spots"], own["touch"]
        measure(self.sensordata, self.rules.layout, world, self.dimensions)
        sound = (own["poses"][:, :2].abs() < self._bounds).all(dim=1)
        sound &= self.sensordata.isfinite().all(dim=1)
        valid &= sound
        for name in ("poses", "wheels", "touch"):
            _zero(own[name], ~sound)
        _zero(self.sensordata, ~valid)

    def arrays(self) -> dict[str, np.ndarray]:
        """See `Robots.arrays`; copies on the host."""
        return {name: tensor.cpu().numpy().copy() for name, tensor in self._tensors.items()}

    def load_arrays(self, arrays: Mapping[str, np.ndarray]) -> None:
        """See `Robots.load_arrays`."""
        self._host.load_arrays(arrays)
        self._send()

    def _fetch(self) -> None:
        self._host.load_arrays(self.arrays())

    def _send(self) -> None:
        for name, array in self._host.arrays().items():
            self._tensors[name].copy_(torch.from_numpy(array))


def _zero(tensor: Tensor, rows: Tensor) -> None:
    """Overwrites rows, given by a mask of shape (B,), with 0."""
    tensor.masked_fill_(rows.view(-1, *[1] * (tensor.dim() - 1)), 0.0)
