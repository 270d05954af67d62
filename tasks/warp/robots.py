"""Robots in lockstep in MuJoCo Warp, with the interface of `batch.Batch`."""

from __future__ import annotations

from typing import Any

import mujoco
import numpy as np

from ..batch import Batch
from ..rules import Rules
from .engine import WarpEngine  # says how to install what is missing, torch included

# isort: split
import torch

# Rounding decides whether a robot that is exactly on the floor has contacts in its first physics
# step, in C MuJoCo too; robots 10 nm above it agree.
_LIFTED = 1e-8  # [m]


class WarpBatch(Batch):
    """B robots in MuJoCo Warp on the default device of PyTorch, with arrays of NumPy.

    All but the physics steps is the `Batch`'s: rules, placements, pictures, states. Robots
    differ from those of a `Batch` by rounding (docs/physics.md).
    """

    def __init__(self, model: mujoco.MjModel, rules: Rules, robots: int) -> None:
        """Places B robots at the origin.

        Args:
          model: Compiled arena.
          rules: Rules of the task for that arena.
          robots: Number of robots, B.

        Raises:
          ModuleNotFoundError: MuJoCo Warp is not installed.
          NotImplementedError: MuJoCo Warp cannot simulate the arena.
          ValueError: robots is below 1, or the timestep does not divide 0.1 s.
        """
        super().__init__(model, rules, robots)
        self.warp = WarpEngine(model, robots, self.substeps)

    def place(self, robots: np.ndarray, poses: np.ndarray) -> None:
        """See `Robots.place`."""
        super().place(robots, poses)
        self._state[np.asarray(robots, dtype=int), 3] = _LIFTED

    def simulate(self) -> np.ndarray:
        """See `Batch.simulate`.

        Raises:
          CapacityError: See `WarpEngine.check_capacity`.
        """
        device = self.warp.device
        state, control = (torch.from_numpy(a).to(device) for a in (self._state, self._control))
        measured = self.warp.simulate(state, control).cpu().numpy()
        self._state[:] = state.cpu().numpy()
        self.warp.check_capacity()
        return measured

    def __setstate__(self, state: dict[str, Any]) -> None:
        """Makes an exact copy on the default device."""
        model, rules, robots, _ = state["made_from"]
        self.__init__(model, rules, robots)
        self.dimensions = state["dimensions"]
        self.set_state(state["state"])
