"""Robots as tensors of PyTorch: the interface and the kinematic simulator."""

from __future__ import annotations

import abc
from collections.abc import Mapping
from typing import Any, ClassVar

import numpy as np
import torch
from torch import Tensor

from ..batch import Robots
from ..kinematic import KinematicBatch, after_control_step, measure, measure_speed
from ..world import World
from .capture import Captured


class TensorRobots(Robots):
    """The robots of a batch on the host, as tensors on the default device.

    `step` takes motors as a tensor of shape (B, 2), and `sensordata` and `valid` are tensors. A
    step copies nothing between the device and the host, and waits for neither. Placements, states
    and checkpoints are arrays of NumPy, as in other batches; the batch on the host handles them.
    """

    _MOTORS: ClassVar[torch.dtype]  # type of motor values

    def __init__(self, batch: Robots) -> None:
        """Takes over the robots of a batch, which is not to be used any more.

        Raises ValueError if the batch has entered another world than the default one.
        """
        super().__init__(batch.robots, batch.rules, batch.dimensions, batch.sensordata.shape[1])
        self.enter(batch.world)
        self._host = batch
        self._device = torch.get_default_device()
        self._bounds = self._constant(batch.dimensions.bounds)
        self._tensors: dict[str, Any] = {  # values: tensors
            name: self._constant(array) for name, array in batch.arrays().items()
        }
        # Motors of a step, at a fixed address, which captured steps read.
        self._given = torch.zeros(batch.robots, 2, dtype=self._MOTORS, device=self._device)
        self.sensordata: Any = self._tensors["sensordata"]
        self.valid: Any = self._tensors["valid"]

    @property
    def pose(self) -> np.ndarray:
        self._fetch()
        return self._host.pose

    @property
    def spot(self) -> np.ndarray:
        self._fetch()
        return self._host.spot

    def enter(self, world: World) -> None:
        """Raises ValueError for any but the default world."""
        if world != World():
            raise ValueError(f"robots on tensors have the default world only, got {world}")

    def place(self, robots: np.ndarray, poses: np.ndarray) -> None:
        self._fetch()
        self._host.place(robots, poses)
        self._send()

    def place_spot(self, robots: np.ndarray, spots: np.ndarray) -> None:
        self._fetch()
        self._host.place_spot(robots, spots)
        self._send()

    def stop(self, robots: np.ndarray) -> None:
        if np.size(robots):
            self._fetch()
            self._host.stop(robots)
            self._send()

    def step(self, motors: Any) -> None:
        if motors.shape != (self.robots, 2):
            shape = self.robots, 2
            raise ValueError(f"motors must have shape {shape}, got {tuple(motors.shape)}")
        self._given.copy_(motors)
        self._advance()

    @abc.abstractmethod
    def _advance(self) -> None:
        """Simulates a control step with the motors in `_given`."""

    def arrays(self) -> dict[str, np.ndarray]:
        """Returns copies on the host of everything that the next steps depend on."""
        return {name: tensor.cpu().numpy().copy() for name, tensor in self._tensors.items()}

    def set_state(self, arrays: Mapping[str, np.ndarray]) -> None:
        self._host.set_state(arrays)
        self._send()

    def _commanded(self) -> Tensor:
        """Returns motor values to follow, (B, 2); a NaN or infinite value makes a robot invalid."""
        motors = self._given
        self.valid &= motors.isfinite().all(dim=1)
        return motors.masked_fill(~self.valid[:, None], 0.0).clamp(-0.5, 0.5)

    def _unsound(self, places: Tensor) -> Tensor:
        """Invalidates robots out of bounds, and makes all invalid robots sense zeros.

        `places` has the first n <= 6 numbers of qpos, shape (B, n). Returns which robots are out of
        bounds or have a sensor that is not finite, shape (B,).
        """
        sound = (places.abs() < self._bounds[: places.shape[1]]).all(dim=1)
        sound &= self.sensordata.isfinite().all(dim=1)
        self.valid &= sound
        self.sensordata.masked_fill_(~self.valid[:, None], 0.0)
        return ~sound

    def _constant(self, array: np.ndarray) -> Tensor:
        return torch.from_numpy(array.copy()).to(self._device)

    def _fetch(self) -> None:
        self._host.set_state(self.arrays())

    def _send(self) -> None:
        for name, array in self._host.arrays().items():
            self._tensors[name].copy_(torch.from_numpy(array))


class KinematicTensors(TensorRobots):
    """The robots of a `KinematicBatch`, as tensors on the default device.

    The equations are those of the `KinematicBatch`; results differ from its results by rounding.
    """

    _MOTORS = torch.float32

    def __init__(self, batch: KinematicBatch) -> None:
        """Takes over the robots of a batch, which is not to be used any more."""
        super().__init__(batch)
        self.kinematics, self.velocity = batch.kinematics, batch.velocity
        self._captured = Captured(self._simulate, self._device)

    def _advance(self) -> None:
        self._captured()

    def _simulate(self) -> None:
        own = self._tensors
        motors: Any = self._commanded()
        poses, wheels, contact = after_control_step(
            own["poses"], own["wheels"], motors, self.kinematics, self.dimensions
        )
        measure_speed(self.sensordata, self.velocity, own["poses"], poses)
        own["poses"].copy_(poses)
        own["wheels"].copy_(wheels)
        own["touch"].copy_(contact)
        world = own["poses"], own["spots"], own["touch"]
        measure(self.sensordata, self.rules.layout, world, self.dimensions)
        unsound = self._unsound(own["poses"][:, :2])
        own["poses"].masked_fill_(unsound[:, None], 0.0)
        own["wheels"].masked_fill_(unsound[:, None], 0.0)
        own["touch"].masked_fill_(unsound, 0.0)
