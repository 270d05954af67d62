"""Robots in lockstep, each alone in its arena, on `mujoco.rollout`.

Model, rules and times of sensing are those of the dm_control tasks: a batch of one equals the
environment bit-exactly (tests/tasks/test_batch.py).
"""

from __future__ import annotations

import abc
import copy
import ctypes
from collections.abc import Mapping
from pathlib import Path

import mujoco
import numpy as np
from mujoco import rollout

from ..models import Dimensions, robot_pose, robot_qpos
from .arena import CONTROL_TIMESTEP
from .rules import Rules

_STATE = mujoco.mjtState.mjSTATE_FULLPHYSICS.value
_CONTROL = mujoco.mjtState.mjSTATE_CTRL.value | mujoco.mjtState.mjSTATE_MOCAP_POS.value


def stop_timers() -> bool:
    """Stops MuJoCo's clock readings in this process (a seventh of a small model's step).

    MuJoCo's bindings time every stage of every step for `data.timer`, which is not used here. The
    clock is a global callback of the library; there is no public switch.

    Returns:
      Whether the callback was found and stopped.
    """
    library = next(Path(mujoco.__file__).parent.glob("libmujoco*"), None)
    if library is None:
        return False
    try:
        ctypes.c_void_p.in_dll(ctypes.CDLL(str(library)), "mjcb_time").value = None
    except (OSError, ValueError):
        return False
    return True


def silence_warnings() -> None:
    """Stops MuJoCo from writing MUJOCO_LOG.TXT; a batch reports failures in `valid`."""
    mujoco.set_mju_user_warning(lambda message: None)


class Robots(abc.ABC):
    """B robots in lockstep, each alone in its arena: the interface of every simulator.

    Attributes:
      robots: Number of robots, B.
      rules: Observations, reward and event of the task.
      dimensions: Dimensions of robot, arena and spot.
      sensordata: Last measurements, shape (B, nsensordata).
      valid: False for a stopped robot, shape (B,). A robot is stopped when its simulation becomes
        unstable, it leaves the arena or its motors are not finite; from then on it stands still
        and senses zeros.
    """

    def __init__(self, robots: int, rules: Rules, dimensions: Dimensions, nsensordata: int) -> None:
        """Initialises B robots that sense zeros.

        Args:
          robots: Number of robots, B.
          rules: Observations, reward and event of the task.
          dimensions: Dimensions of robot, arena and spot.
          nsensordata: Number of values in a robot's `sensordata`.

        Raises:
          ValueError: robots is below 1.
        """
        if robots < 1:
            raise ValueError(f"robots must be at least 1, got {robots}")
        self.robots = robots
        self.rules = rules
        self.dimensions = dimensions
        self.sensordata = np.zeros((robots, nsensordata))
        self.valid = np.ones(robots, dtype=bool)

    @property
    @abc.abstractmethod
    def pose(self) -> np.ndarray:
        """x, y in [m] and heading in [rad] of every robot, shape (B, 3)."""

    @property
    @abc.abstractmethod
    def spot(self) -> np.ndarray:
        """x, y of every robot's spot in [m], shape (B, 2)."""

    @abc.abstractmethod
    def place(self, robots: np.ndarray, poses: np.ndarray) -> None:
        """Places robots at rest, and updates their sensors.

        Args:
          robots: Indices of the robots, shape (n,).
          poses: x, y in [m] and heading in [rad], shape (n, 3).
        """

    @abc.abstractmethod
    def place_spot(self, robots: np.ndarray, spots: np.ndarray) -> None:
        """Moves robots' spots; sensors show the move after the next step or placement.

        Args:
          robots: Indices of the robots, shape (n,).
          spots: Centres of the spots: x, y in [m], shape (n, 2).
        """

    @abc.abstractmethod
    def step(self, motors: np.ndarray) -> None:
        """Simulates a control step of 0.1 s.

        Args:
          motors: Motor values, left and right, shape (B, 2). Values beyond [-0.5, 0.5] are
            clipped; a robot whose values are not finite becomes invalid.
        """

    @abc.abstractmethod
    def arrays(self) -> dict[str, np.ndarray]:
        """Returns everything that the next steps depend on, for a checkpoint."""

    def load_arrays(self, arrays: Mapping[str, np.ndarray]) -> None:
        """Restores a checkpoint; the robots continue from it bit-exactly.

        Args:
          arrays: Arrays that `arrays` returned.

        Raises:
          ValueError: An array is missing or has the wrong shape.
        """
        for name, target in self.arrays().items():
            if name not in arrays or arrays[name].shape != target.shape:
                got = f"shape {arrays[name].shape}" if name in arrays else "none"
                raise ValueError(f"{name} must have shape {target.shape}, got {got}")
            target[:] = arrays[name]

    def stop(self, robots: np.ndarray) -> None:
        """Makes robots invalid.

        Args:
          robots: Indices of the robots, shape (n,), or a mask, shape (B,).
        """
        self.valid[robots] = False
        self.sensordata[robots] = 0

    def _finite_motors(self, motors: np.ndarray) -> np.ndarray:
        """Invalidates robots whose motors are not finite; returns 0 for all invalid robots."""
        self.valid &= np.isfinite(motors).all(axis=1)
        return motors if self.valid.all() else np.where(self.valid[:, None], motors, 0.0)


class _Call:
    """A rollout of some physics steps of all robots, with its arrays allocated once."""

    def __init__(
        self, model: mujoco.MjModel, state: np.ndarray, control: np.ndarray, steps: int
    ) -> None:
        """Allocates the arrays of a rollout.

        Args:
          model: Compiled arena.
          state: Physics states of the robots, shape (B, n); `step` updates them.
          control: Controls of the robots, shape (B, m).
          steps: Number of physics steps.
        """
        robots = len(state)
        self._models = [model] * robots  # rollout's skip_checks needs one per robot
        self._state, self._control, self._steps = state, control, steps
        self._held = np.zeros((robots, steps, control.shape[1]))
        self._states = np.zeros((robots, steps, state.shape[1]))
        self._sensors = np.zeros((robots, steps, model.nsensordata))

    @property
    def sensordata(self) -> np.ndarray:
        """Measurements of the last step, shape (B, nsensordata)."""
        return self._sensors[:, -1]

    def step(self, engine: rollout.Rollout, scratch: list[mujoco.MjData]) -> None:
        """Simulates the steps, and updates the state."""
        self._held[:] = self._control[:, None]
        engine.rollout(
            self._models,
            scratch,
            self._state,
            self._held,
            nstep=self._steps,
            control_spec=_CONTROL,
            state=self._states,
            sensordata=self._sensors,
            skip_checks=True,
        )
        self._state[:] = self._states[:, -1]


class Batch(Robots):
    """B robots in MuJoCo.

    Attributes:
      model: Compiled arena, shared by all robots.
      substeps: Number of physics steps in a control step.
    """

    def __init__(
        self, model: mujoco.MjModel, rules: Rules, robots: int, *, threads: int = 0
    ) -> None:
        """Places B robots at the origin.

        Args:
          model: Compiled arena.
          rules: Rules of the task for that arena.
          robots: Number of robots, B.
          threads: Number of threads that step the physics; 0 for the calling thread. Results do
            not depend on it: a robot's step depends on its own state alone.

        Raises:
          ValueError: robots is below 1, threads is negative, or the timestep does not divide
            0.1 s.
        """
        super().__init__(robots, rules, Dimensions.of(model), model.nsensordata)
        if threads < 0:
            raise ValueError(f"threads must not be negative, got {threads}")
        self.model = model
        self.substeps = round(CONTROL_TIMESTEP / model.opt.timestep)
        if abs(self.substeps * model.opt.timestep - CONTROL_TIMESTEP) > 1e-9:
            raise ValueError(f"the timestep must divide 0.1 s, got {model.opt.timestep}")

        self._threads = [mujoco.MjData(model) for _ in range(max(threads, 1))]
        self._scratch = self._threads[0]
        self._engine = rollout.Rollout(nthread=threads)
        # Sensors are read once per control step: only its last substep evaluates them.
        blind = copy.copy(model)
        blind.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_SENSOR
        size = mujoco.mj_stateSize(model, _STATE)
        self._state = np.zeros((robots, size))
        self._control = np.zeros((robots, mujoco.mj_stateSize(model, _CONTROL)))
        self._control[:, model.nu :] = self._scratch.mocap_pos.ravel()
        self._calls = [
            _Call(seeing, self._state, self._control, steps)
            for seeing, steps in ((blind, self.substeps - 1), (model, 1))
            if steps
        ]
        self.place(np.arange(robots), np.zeros((robots, 3)))

    @property
    def pose(self) -> np.ndarray:
        """See `Robots.pose`."""
        return robot_pose(self._state[:, 1:])

    @property
    def spot(self) -> np.ndarray:
        """See `Robots.spot`."""
        return self._control[:, self.model.nu : self.model.nu + 2].copy()

    def place(self, robots: np.ndarray, poses: np.ndarray) -> None:
        """See `Robots.place`."""
        nq = self.model.nq
        self._state[robots] = 0
        self._state[robots, 1 : 1 + nq] = robot_qpos(poses)
        self._control[robots, : self.model.nu] = 0
        for robot in robots:
            mujoco.mj_setState(self.model, self._scratch, self._state[robot], _STATE)
            mujoco.mj_setState(self.model, self._scratch, self._control[robot], _CONTROL)
            mujoco.mj_forward(self.model, self._scratch)
            self.sensordata[robot] = self._scratch.sensordata if self.valid[robot] else 0

    def place_spot(self, robots: np.ndarray, spots: np.ndarray) -> None:
        """See `Robots.place_spot`."""
        nu = self.model.nu
        self._control[robots, nu : nu + 2] = spots

    def step(self, motors: np.ndarray) -> None:
        """See `Robots.step`."""
        np.clip(self._finite_motors(motors), -0.5, 0.5, out=self._control[:, : self.model.nu])
        time = self._state[:, 0].copy()
        self.simulate()
        self.sensordata[:] = self._calls[-1].sensordata
        self._stop_unstable(time)

    def simulate(self) -> None:
        """Simulates the physics of a control step: the part of `step` that benchmarks time."""
        for call in self._calls:
            call.step(self._engine, self._threads)

    def arrays(self) -> dict[str, np.ndarray]:
        """See `Robots.arrays`."""
        return {
            "state": self._state,
            "control": self._control,
            "sensordata": self.sensordata,
            "valid": self.valid,
        }

    def _stop_unstable(self, time: np.ndarray) -> None:
        # MuJoCo resets an unstable simulation, and rollout stops at a warning: in both cases the
        # clock advances by less than a control step. Comparisons with NaN are false.
        now, x, y = self._state[:, :3].T
        sound = np.abs(now - time - CONTROL_TIMESTEP) < 1e-6
        sound &= np.abs(x) < self.dimensions.half_length
        sound &= np.abs(y) < self.dimensions.half_width
        if not sound.all():
            broken = np.flatnonzero(~sound)
            self.valid[broken] = False
            self.place(broken, np.zeros((len(broken), 3)))
        if not self.valid.all():
            self.sensordata[~self.valid] = 0
