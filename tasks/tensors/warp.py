"""MuJoCo Warp: MuJoCo's physics of many robots at once, in single precision, for a GPU."""

from __future__ import annotations

import copy
import math
import warnings

import mujoco
import numpy as np

from ...extras import extra_needed
from ..batch import Batch, CapacityError
from ..rules import Rules

with extra_needed("warp"):
    import mujoco_warp as mjw
    import torch
    import warp as wp
    from torch import Tensor

from .capture import Captured
from .robots import TensorRobots

# Per robot: at least twice what driving into walls, corners and pillars needs (see the tests).
_CONTACTS, _ROWS = 32, 128
# Reaching the limit of iterations is no overflow: C MuJoCo stops there too.
_OVERFLOW = mjw.OverflowType.ALL & ~(mjw.OverflowType.ITERATIONS | mjw.OverflowType.LS_ITERATIONS)
# Rounding decides whether a robot that is exactly on the floor has contacts in its first physics
# step, in C MuJoCo too; 10 nm above it, both simulators agree.
_LIFTED = 1e-8  # [m]


class WarpEngine:
    """Physics steps of B robots on the default device of PyTorch.

    Attributes:
      device: Device of the simulation: PyTorch's default device when the engine was made.
    """

    def __init__(self, model: mujoco.MjModel, robots: int, substeps: int) -> None:
        """Moves a compiled arena to the device, for B robots.

        Kernels are compiled here, which takes a minute the first time; they are kept on the disk.
        """
        self.device = torch.get_default_device()
        # Warp starts without its greeting, and without its warning that there is no GPU.
        wp.config.log_level = wp.LOG_ERROR if self.device.type == "cpu" else wp.LOG_WARNING
        wp.init()
        wp.config.log_level = wp.LOG_WARNING
        self._wp_device = wp.device_from_torch(self.device)
        # Sensors are read once per control step, at the start of its last substep, as in `Batch`.
        flags = mujoco.mjtDisableBit
        seeing, blind = copy.copy(model), copy.copy(model)
        for one in (seeing, blind):  # Warp has a broad phase of its own
            one.opt.disableflags &= ~flags.mjDSBL_MIDPHASE.value
        blind.opt.disableflags |= flags.mjDSBL_SENSOR.value
        with wp.ScopedDevice(self._wp_device), warnings.catch_warnings():
            # Warp warns of frictionless walls; a contact has the larger friction of its two geoms.
            warnings.filterwarnings("ignore", r"geom \d+: friction", UserWarning)
            self._models = [mjw.put_model(blind)] * (substeps - 1) + [mjw.put_model(seeing)]
            self._data = mjw.make_data(model, robots, nconmax=_CONTACTS, njmax=_ROWS)
        for one in self._models:
            one.opt.warn_overflow = 0  # `check_capacity` reads overflows
        self._position = wp.to_torch(self._data.qpos)
        self._velocity = wp.to_torch(self._data.qvel)
        self._motors = wp.to_torch(self._data.ctrl)
        self._spots = wp.to_torch(self._data.mocap_pos)
        self._measured = wp.to_torch(self._data.sensordata)
        self._overflow = wp.to_torch(self._data.overflow)
        self._timestep = model.opt.timestep
        with wp.ScopedDevice(self._wp_device):
            self._launch()  # compiles and loads the kernels, which a capture cannot
            with wp.ScopedCapture(self._wp_device) as capture:
                self._launch()
        assert capture.graph is not None
        self._graph = capture.graph
        self._overflow.zero_()

    def load(self, state: Tensor, control: Tensor) -> None:
        """Takes over the robots' state and control, on the device.

        Args:
          state: Time, qpos and qvel, shape (B, 1 + nq + nv).
          control: Motor values, then x, y, z of the spot's centre, shape (B, nu + 3).
        """
        nq, nu = self._position.shape[1], self._motors.shape[1]
        self._position.copy_(state[:, 1 : 1 + nq])
        self._velocity.copy_(state[:, 1 + nq :])
        self._motors.copy_(control[:, :nu])
        self._spots[:, 0].copy_(control[:, nu:])

    def run(self) -> None:
        """Launches the kernels of all substeps; on a GPU, on PyTorch's stream."""
        if not self._wp_device.is_cuda:
            wp.capture_launch(self._graph)
            return
        with wp.ScopedStream(wp.stream_from_torch(torch.cuda.current_stream(self.device))):
            wp.capture_launch(self._graph)

    def read(self, state: Tensor) -> Tensor:
        """Overwrites `state`, and returns the measurements, shape (B, nsensordata).

        They are valid until the next `run`.
        """
        nq = self._position.shape[1]
        state[:, 0] += len(self._models) * self._timestep
        state[:, 1 : 1 + nq].copy_(self._position)
        # In single precision, a wheel's angle stops growing after hours: keep it modulo 2 pi.
        turned = state[:, nq - 1 : 1 + nq]
        turned.copy_(torch.remainder(turned + math.pi, 2 * math.pi) - math.pi)
        state[:, 1 + nq :].copy_(self._velocity)
        return self._measured

    def check_capacity(self) -> None:
        """Waits for the device; CapacityError if contacts were dropped since the last check."""
        full = (self._overflow & int(_OVERFLOW)).nonzero().flatten().tolist()
        if full:
            self._overflow.zero_()
            raise CapacityError(
                f"MuJoCo Warp dropped contacts or constraints of {len(full)} robots, the first is "
                f"robot {full[0]}: room is for {_CONTACTS} contacts and {_ROWS} rows a robot"
            )

    def _launch(self) -> None:
        for number, model in enumerate(self._models):
            if number in (0, len(self._models) - 1):  # where C MuJoCo's rollouts begin
                self._data.qacc_warmstart.zero_()
            mjw.step(model, self._data)


class WarpBatch(Batch):
    """B robots in MuJoCo Warp on the default device of PyTorch, with arrays of NumPy.

    Only the physics steps differ from those of a `Batch`, by rounding (docs/physics.md). Copies use
    the default device. Raises ModuleNotFoundError where MuJoCo Warp is not installed,
    NotImplementedError where it cannot simulate the arena.
    """

    def __init__(self, model: mujoco.MjModel, rules: Rules, robots: int) -> None:
        super().__init__(model, rules, robots)
        self.warp = WarpEngine(model, robots, self.substeps)

    def place(self, robots: np.ndarray, poses: np.ndarray) -> None:
        super().place(robots, poses)
        self._state[np.asarray(robots, dtype=int), 3] = _LIFTED

    def simulate(self) -> np.ndarray:
        """Does what `Batch.simulate` does; raises CapacityError if contacts were dropped."""
        device = self.warp.device
        state, control = (torch.from_numpy(a).to(device) for a in (self._state, self._control))
        self.warp.load(state, control)
        self.warp.run()
        measured = self.warp.read(state).cpu().numpy()
        self._state[:] = state.cpu().numpy()
        self.warp.check_capacity()
        return measured


class WarpTensors(TensorRobots):
    """Robots in MuJoCo Warp as tensors on the default device, equal to those of a `WarpBatch`."""

    _MOTORS = torch.float64

    def __init__(self, batch: Batch) -> None:
        """Makes robots in the arena of a batch, at the origin.

        Raises ValueError if the batch has entered another world.
        """
        self.enter(batch.world)
        batch = WarpBatch(batch.model, batch.rules, batch.robots)
        super().__init__(batch)
        self._warp = batch.warp
        self._motors = self._tensors["control"][:, : batch.model.nu]
        self._rest = self._constant(batch.arrays()["state"][0])
        self._before = Captured(self._load, self._device)
        self._after = Captured(self._read, self._device)

    def _advance(self) -> None:
        self._before()
        self._warp.run()  # replays a graph of Warp
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
        """Does what `Robots.stop` does; raises CapacityError if contacts were dropped."""
        self._warp.check_capacity()
        super().stop(robots)
