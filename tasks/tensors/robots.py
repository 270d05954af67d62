"""What robots on tensors have in common: places, states and checkpoints."""

from __future__ import annotations

import abc
from collections.abc import Mapping
from typing import Any, ClassVar

import numpy as np
import torch
from torch import Tensor

from ..batch import Robots


class TensorRobots(Robots):
    """The robots of a batch on the host, as tensors on the default device.

    `step` takes motors as a tensor of shape (B, 2), and `sensordata` and `valid` are tensors. A
    step copies nothing between the device and the host, and waits for no number. Placements, states
    and checkpoints are arrays of NumPy, as of other batches; the batch on the host makes them.
    """

    _MOTORS: ClassVar[torch.dtype]  # in which motor values are kept

    def __init__(self, batch: Robots) -> None:
        """Takes over the robots of a batch, which is not to be used any more."""
        super().__init__(batch.robots, batch.rules, batch.dimensions, batch.sensordata.shape[1])
        self._host = batch
        self._device = torch.get_default_device()
        self._bounds = self._constant(batch.dimensions.bounds)
        self._tensors: dict[str, Any] = {  # of tensors
            name: self._constant(array) for name, array in batch.arrays().items()
        }
        # Motors of a step, in a place that a captured step knows.
        self._given = torch.zeros(batch.robots, 2, dtype=self._MOTORS, device=self._device)
        self.sensordata: Any = self._tensors["sensordata"]
        self.valid: Any = self._tensors["valid"]

    @property
    def pose(self) -> np.ndarray:
        """See `Robots.pose`."""
        self._fetch()
        return self._host.pose

    @property
    def spot(self) -> np.ndarray:
        """See `Robots.spot`."""
        self._fetch()
        return self._host.spot

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
          motors: Motor values, left and right, a tensor of shape (B, 2). Values beyond [-0.5, 0.5]
            are clipped; a robot whose values are not finite becomes invalid.

        Raises:
          ValueError: the motors have another shape.
        """
        if motors.shape != (self.robots, 2):
            shape = self.robots, 2
            raise ValueError(f"motors must have shape {shape}, got {tuple(motors.shape)}")
        self._given.copy_(motors)
        self._advance()

    @abc.abstractmethod
    def _advance(self) -> None:
        """Simulates a control step with the motors in `_given`."""

    def arrays(self) -> dict[str, np.ndarray]:
        """See `Robots.arrays`; copies on the host."""
        return {name: tensor.cpu().numpy().copy() for name, tensor in self._tensors.items()}

    def load_arrays(self, arrays: Mapping[str, np.ndarray]) -> None:
        """See `Robots.load_arrays`."""
        self._host.load_arrays(arrays)
        self._send()

    def _commanded(self) -> Tensor:
        """Returns motor values that the motors follow, shape (B, 2).

        Invalidates robots whose motors are not finite.
        """
        motors = self._given
        self.valid &= motors.isfinite().all(dim=1)
        return motors.masked_fill(~self.valid[:, None], 0.0).clamp(-0.5, 0.5)

    def _unsound(self, places: Tensor) -> Tensor:
        """Invalidates robots out of bounds, and makes all invalid robots sense zeros.

        Args:
          places: The first n <= 6 numbers of qpos, shape (B, n).

        Returns:
          Which robots are out of bounds or have sensors that are not finite, shape (B,).
        """
        sound = (places.abs() < self._bounds[: places.shape[1]]).all(dim=1)
        sound &= self.sensordata.isfinite().all(dim=1)
        self.valid &= sound
        self.sensordata.masked_fill_(~self.valid[:, None], 0.0)
        return ~sound

    def _constant(self, array: np.ndarray) -> Tensor:
        return torch.from_numpy(array.copy()).to(self._device)

    def _fetch(self) -> None:
        self._host.load_arrays(self.arrays())

    def _send(self) -> None:
        for name, array in self._host.arrays().items():
            self._tensors[name].copy_(torch.from_numpy(array))
