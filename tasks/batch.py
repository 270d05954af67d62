"""Many robots in lockstep, each alone in its arena, on `mujoco.rollout`.

Same model, same rules, same instants as the dm_control tasks: a batch of one is the ordinary
environment, to the bit (tests/test_batch.py).
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
from .arena import CONTROL_TIMESTEP, Rules

_STATE = mujoco.mjtState.mjSTATE_FULLPHYSICS.value
_CONTROL = mujoco.mjtState.mjSTATE_CTRL.value | mujoco.mjtState.mjSTATE_MOCAP_POS.value


def stop_timers() -> bool:
    """Stops MuJoCo's clock readings in this process, a seventh of a small model's step.

    MuJoCo's bindings time every stage of every step for `data.timer`, which nothing here
    reads. The clock is a global callback of the library; there is no public switch.

    Returns:
      Whether it was found and stopped.
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
    """Keeps MuJoCo from writing MUJOCO_LOG.TXT; a batch tells by `valid` what went wrong."""
    mujoco.set_mju_user_warning(lambda message: None)


class Robots(abc.ABC):
    """B robots in lockstep, each alone in its arena: what every body has in common.

    Attributes:
      robots: B.
      rules: what the robots sense and are rewarded for.
      dimensions: of robot, arena and spot.
      sensordata: what was last measured, shape (B, nsensordata).
      valid: False for a robot that was stopped, because its simulation became unstable, it
        left the arena or its motors were not finite: it stands still and senses zeros for
        good, shape (B,).
    """

    def __init__(self, robots: int, rules: Rules, dimensions: Dimensions, nsensordata: int) -> None:
        """Makes B robots that sense zeros.

        Raises:
          ValueError: robots is not positive.
        """
        if robots < 1:
            raise ValueError(f"robots must be positive, got {robots}")
        self.robots = robots
        self.rules = rules
        self.dimensions = dimensions
        self.sensordata = np.zeros((robots, nsensordata))
        self.valid = np.ones(robots, dtype=bool)

    @property
    @abc.abstractmethod
    def pose(self) -> np.ndarray:
        """x, y in metres and heading in radians of every robot, shape (B, 3)."""

    @property
    @abc.abstractmethod
    def spot(self) -> np.ndarray:
        """x, y of every robot's spot, in metres, shape (B, 2)."""

    @abc.abstractmethod
    def place(self, robots: np.ndarray, poses: np.ndarray) -> None:
        """Puts robots, at rest, at poses, and lets them sense.

        Args:
          robots: indices, shape (n,).
          poses: x, y in metres and heading in radians, shape (n, 3).
        """

    @abc.abstractmethod
    def place_spot(self, robots: np.ndarray, spots: np.ndarray) -> None:
        """Moves robots' spots; they smell the change after the next step, or placement.

        Args:
          robots: indices, shape (n,).
          spots: x, y in metres, shape (n, 2).
        """

    @abc.abstractmethod
    def step(self, motors: np.ndarray) -> None:
        """Drives every robot for a control step of 0.1 s.

        Args:
          motors: left and right, shape (B, 2); values beyond [-0.5, 0.5] are clipped, and a
            robot whose values are not finite becomes invalid.
        """

    @abc.abstractmethod
    def arrays(self) -> dict[str, np.ndarray]:
        """Everything that the next steps depend on, for a checkpoint."""

    def load_arrays(self, arrays: Mapping[str, np.ndarray]) -> None:
        """Goes on from `arrays`, to the bit.

        Raises:
          ValueError: an array is missing, or its shape is another.
        """
        for name, target in self.arrays().items():
            if name not in arrays or arrays[name].shape != target.shape:
                raise ValueError(f"{name} must have shape {target.shape}")
            target[:] = arrays[name]

    def stop(self, robots: np.ndarray) -> None:
        """Makes robots invalid, as whoever drives them may have reason to.

        Args:
          robots: indices or a mask.
        """
        self.valid[robots] = False
        self.sensordata[robots] = 0

    def _sound(self, motors: np.ndarray) -> np.ndarray:
        """The motors, with those of stopped robots and of robots to be stopped at zero."""
        self.valid &= np.isfinite(motors).all(axis=1)
        return motors if self.valid.all() else np.where(self.valid[:, None], motors, 0.0)


class _Call:
    """A rollout of some physics steps of all robots, and the arrays that it wants."""

    def __init__(
        self, model: mujoco.MjModel, state: np.ndarray, control: np.ndarray, steps: int
    ) -> None:
        """Prepares `steps` physics steps of robots of a state (B, n) under a control (B, m)."""
        robots = len(state)
        self._models = [model] * robots  # rollout's skip_checks wants one a robot
        self._state, self._control, self._steps = state, control, steps
        self._held = np.zeros((robots, steps, control.shape[1]))
        self._states = np.zeros((robots, steps, state.shape[1]))
        self._sensors = np.zeros((robots, steps, model.nsensordata))

    @property
    def sensordata(self) -> np.ndarray:
        """What the last of the steps sensed, shape (B, nsensordata)."""
        return self._sensors[:, -1]

    def step(self, engine: rollout.Rollout, scratch: list[mujoco.MjData]) -> None:
        """Moves the state on."""
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
    """Robots in MuJoCo, stepped together.

    Attributes:
      model: the compiled arena, the same for all.
      substeps: physics steps in a control step.
    """

    def __init__(
        self, model: mujoco.MjModel, rules: Rules, robots: int, *, threads: int = 0
    ) -> None:
        """Makes B robots, all at the origin.

        Args:
          model: a compiled arena.
          rules: of the task, for that arena.
          robots: B.
          threads: that step the physics; 0 for the calling thread. Each robot's step depends
            on its own state alone, so that results do not depend on it.

        Raises:
          ValueError: robots is not positive, threads is negative, or the timestep does not
            divide 0.1 s.
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
        # Sensors are read once a control step, so only its last substep pays for them.
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
        np.clip(self._sound(motors), -0.5, 0.5, out=self._control[:, : self.model.nu])
        time = self._state[:, 0].copy()
        self.simulate()
        self.sensordata[:] = self._calls[-1].sensordata
        self._check(time)

    def simulate(self) -> None:
        """The physics of a control step, and nothing else: `step` calls it."""
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

    def _check(self, time: np.ndarray) -> None:
        # MuJoCo resets an unstable simulation, and rollout breaks off at a warning: either
        # way the clock shows less than a control step. Comparisons with NaN are false.
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
