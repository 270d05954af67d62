"""Robots in lockstep, each alone in its arena, on `mujoco.rollout`.

Model, rules and times of sensing are those of the dm_control tasks: a batch of one equals the
environment bit-exactly (tests/tasks/test_gymnasium_env.py).
"""

from __future__ import annotations

import abc
import contextlib
import ctypes
import os
import weakref
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import mujoco
import numpy as np
from mujoco import rollout

from ..models import Dimensions, robot_pose, robot_qpos
from .episode import CONTROL_TIMESTEP, check_state, real_numbers, whole_number
from .rules import Rules
from .world import World

_STATE = mujoco.mjtState.mjSTATE_FULLPHYSICS.value
_SENSORS = mujoco.mjtDisableBit.mjDSBL_SENSOR.value
_CONTROL = mujoco.mjtState.mjSTATE_CTRL.value | mujoco.mjtState.mjSTATE_MOCAP_POS.value
_MOST_SUBSTEPS = 10_000


def stop_timers() -> bool:
    """Stops MuJoCo's timers in this process; they take a seventh of a small model's step time.

    MuJoCo's bindings time every stage of every step for `data.timer`, which is not used here. The
    clock is a global callback without a public switch. Returns whether the clock was found.
    """
    for library in Path(mujoco.__file__).parent.glob("libmujoco*"):
        with contextlib.suppress(OSError, ValueError):
            ctypes.c_void_p.in_dll(ctypes.CDLL(str(library)), "mjcb_time").value = None
            return True
    return False


def silence_warnings() -> None:
    """Stops MuJoCo from writing MUJOCO_LOG.TXT; a batch reports failures in `valid`."""
    mujoco.set_mju_user_warning(lambda message: None)


class CapacityError(RuntimeError):
    """A simulator had no room for all contacts of some robots."""


def substeps_of(model: mujoco.MjModel) -> int:
    """Returns how many physics steps make 0.1 s; ValueError unless a whole number up to 10,000."""
    timestep = model.opt.timestep
    substeps = round(CONTROL_TIMESTEP / timestep) if timestep > 1e-9 else 0
    exact = substeps > 0 and abs(CONTROL_TIMESTEP / timestep - substeps) <= 1e-8  # as in dm_control
    if not exact or timestep > CONTROL_TIMESTEP or substeps > _MOST_SUBSTEPS:
        raise ValueError(
            f"the timestep must divide 0.1 s, into at most {_MOST_SUBSTEPS} steps, got {timestep}"
        )
    return substeps


class Robots(abc.ABC):
    """B robots in lockstep, each alone in its arena: the interface of every simulator.

    Attributes:
      robots: Number of robots, B.
      task_rules: Rules of the task in the default world.
      rules: Rules of the task in the present world: observations, reward and measured event.
      dimensions: Dimensions of robot, arena and spot, equal for all robots.
      world: World of all robots, which `enter` changes.
      sensordata: Last measurements in MuJoCo's layout, shape (B, nsensordata).
      valid: False for a stopped robot, shape (B,). A robot is stopped when its simulation becomes
        unstable, it leaves the arena or the floor, it tips over, or its motors or sensors are not
        finite; from then on its motors are 0 and its sensors read 0.
    """

    def __init__(self, robots: int, rules: Rules, dimensions: Dimensions, nsensordata: int) -> None:
        """Initialises B robots that sense zeros; ValueError unless B is at least 1."""
        self.robots = whole_number("robots", robots, 1)
        self.rules = self.task_rules = rules
        self.dimensions = dimensions
        self.world = World()
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
        """Places the robots with these indices, shape (n,), at rest, and updates their sensors.

        Poses are x, y in [m] and heading in [rad], shape (n, 3). Raises ValueError where there is
        no such robot, or the poses have a wrong shape or type.
        """

    @abc.abstractmethod
    def place_spot(self, robots: np.ndarray, spots: np.ndarray) -> None:
        """Moves robots' spots; sensors show the move after the next step or placement.

        The spots are x, y in [m], shape (n, 2). Raises ValueError as `place` does.
        """

    @abc.abstractmethod
    def step(self, motors: np.ndarray) -> None:
        """Simulates a control step of 0.1 s.

        Args:
          motors: Motor values, left and right, shape (B, 2). Values beyond [-0.5, 0.5] are
            clipped; a robot whose values are not finite becomes invalid.

        Raises ValueError where the motors have a wrong shape or type.
        """

    @abc.abstractmethod
    def arrays(self) -> dict[str, np.ndarray]:
        """Returns everything that the next steps depend on, for a checkpoint.

        A simulator on the host returns the arrays themselves, not copies.
        """

    def enter(self, world: World) -> None:
        """Changes the world of all robots, and with it how `rules` read the last measurements.

        `get_state` leaves the world out. Raises ValueError where the world changes or rewards what
        robots of this task do not sense.
        """
        if world != self.world:
            self.rules = world.rules(self.task_rules, self.dimensions.nose)
            self.world = world

    def set_state(self, arrays: Mapping[str, np.ndarray]) -> None:
        """Restores what `arrays` returned; the robots continue from it bit-exactly.

        Raises ValueError where an array is missing or has a wrong shape or type; nothing changes.
        """
        own = self.arrays()
        check_state(arrays, own)
        for name, target in own.items():
            target[:] = arrays[name]

    def stop(self, robots: np.ndarray) -> None:
        """Makes the robots with these indices, shape (n,), invalid."""
        self.valid[robots] = False
        self.sensordata[robots] = 0

    def get_state(self) -> dict[str, np.ndarray]:
        """Returns a copy of everything that the next steps depend on."""
        return {name: array.copy() for name, array in self.arrays().items()}

    def _placed(
        self, robots: Any, places: Any, what: str, width: int
    ) -> tuple[np.ndarray, np.ndarray]:
        """Returns checked indices of robots, shape (n,), and their places, shape (n, width)."""
        robots = np.asarray(robots)
        count = len(robots) if robots.shape == (robots.size,) else -1
        if count < 0 or (count and robots.dtype.kind not in "iu"):
            raise ValueError(f"robots must be indices of shape (n,), got {robots!r:.200}")
        if count and not 0 <= robots.min() <= robots.max() < self.robots:
            raise ValueError(f"robots must lie in [0, {self.robots - 1}], got {robots!r:.200}")
        return robots.astype(int), real_numbers(what, places, (count, width))

    def _finite_motors(self, motors: np.ndarray) -> np.ndarray:
        """Invalidates robots whose motors are not finite.

        Returns the motor values that reach the wheels in this world, 0 for all invalid robots.
        """
        motors = real_numbers("motors", motors, (self.robots, 2))
        if not np.isfinite(motors).all():
            self.valid &= np.isfinite(motors).all(axis=1)
        motors = motors if self.valid.all() else np.where(self.valid[:, None], motors, 0.0)
        return self.world.motors(motors)

    def _stop_unsound(self, sound: np.ndarray) -> None:
        """Invalidates robots with a False in `sound`, (B, n), or a sensor that is not finite.

        All invalid robots sense zeros.
        """
        finite = np.isfinite(self.sensordata)
        if not (sound.all() and finite.all()):
            broken = np.flatnonzero(~(sound.all(axis=1) & finite.all(axis=1)))
            self.valid[broken] = False
            self.place(broken, np.zeros((len(broken), 3)))
        if not self.valid.all():
            self.sensordata[~self.valid] = 0


class _Rollout(NamedTuple):
    """Substeps that skip the same parts of the physics, and arrays that are allocated once."""

    disabled: int  # flags of the parts that are skipped
    control: np.ndarray  # in each substep, shape (B, substeps, ...)
    states: np.ndarray  # after each substep
    sensors: np.ndarray  # at the start of each substep


class Batch(Robots):
    """B robots in MuJoCo; only one thread at a time may step or place them.

    Attributes:
      model: Compiled arena of all robots; changes take effect at the next step. Batches in several
        threads need a model each, because a step sets flags of the model.
      substeps: Number of physics steps in a control step.
    """

    def __init__(
        self, model: mujoco.MjModel, rules: Rules, robots: int, *, threads: int = 0
    ) -> None:
        """Places B robots at the origin, each alone in the arena.

        Args:
          model: Compiled arena, which all robots share.
          rules: Rules of the task, made for this arena by `Rules.of`.
          robots: Number of robots, B.
          threads: Number of threads that step the physics; 0 for the calling thread. Results do not
            depend on it.

        Raises ValueError for no robots, negative threads or a wrong timestep, see `substeps_of`.
        """
        super().__init__(robots, rules, Dimensions.of(model), model.nsensordata)
        self.model = model
        self.substeps = substeps_of(model)
        self._nthread = whole_number("threads", threads, 0)
        self._threads = [mujoco.MjData(model) for _ in range(max(threads, 1))]
        self._scratch = self._threads[0]
        self._engine: rollout.Rollout | None = None
        _BATCHES.add(self)
        size = mujoco.mj_stateSize(model, _STATE)
        self._state = np.zeros((robots, size))
        self._control = np.zeros((robots, mujoco.mj_stateSize(model, _CONTROL)))
        self._control[:, model.nu :] = self._scratch.mocap_pos.ravel()
        # Sensors are read once per control step: only its last substep evaluates them.
        widths = self._control.shape[1], size, model.nsensordata
        self._rollouts = [
            _Rollout(disabled, *(np.zeros((robots, steps, width)) for width in widths))
            for disabled, steps in ((_SENSORS, self.substeps - 1), (0, 1))
            if steps
        ]
        self._models = [model] * robots  # rollout's skip_checks needs a model per robot
        self.place(np.arange(robots), np.zeros((robots, 3)))

    @property
    def pose(self) -> np.ndarray:
        return robot_pose(self._state[:, 1:])

    @property
    def spot(self) -> np.ndarray:
        return self._control[:, self.model.nu : self.model.nu + 2].copy()

    def place(self, robots: np.ndarray, poses: np.ndarray) -> None:
        robots, poses = self._placed(robots, poses, "poses", 3)
        nq = self.model.nq
        self._state[robots] = 0
        self._state[robots, 1 : 1 + nq] = robot_qpos(poses)
        self._control[robots, : self.model.nu] = 0
        for robot in robots:
            self.show(robot, self._scratch)
            self.sensordata[robot] = self._scratch.sensordata if self.valid[robot] else 0

    def place_spot(self, robots: np.ndarray, spots: np.ndarray) -> None:
        nu = self.model.nu
        robots, spots = self._placed(robots, spots, "spots", 2)
        self._control[robots, nu : nu + 2] = spots

    def step(self, motors: np.ndarray) -> None:
        np.clip(self._finite_motors(motors), -0.5, 0.5, out=self._control[:, : self.model.nu])
        time = self._state[:, 0].copy()
        self.sensordata[:] = self.simulate()
        self._stop_unsound(self._sound(time))

    def show(self, robot: int, data: mujoco.MjData) -> None:
        """Copies a robot's state into MuJoCo's data, for a picture; IndexError for a bad number."""
        if not 0 <= robot < self.robots:
            raise IndexError(f"robot must lie in [0, {self.robots - 1}], got {robot}")
        mujoco.mj_setState(self.model, data, self._state[robot], _STATE)
        mujoco.mj_setState(self.model, data, self._control[robot], _CONTROL)
        data.qacc_warmstart[:] = 0  # so that forces depend on the state alone
        mujoco.mj_forward(self.model, data)

    def simulate(self) -> np.ndarray:
        """Simulates the physics of a control step, without checks.

        Returns the measurements at the start of the last physics step, shape (B, nsensordata).
        """
        engine = self._engine
        if engine is None:
            engine = self._engine = rollout.Rollout(nthread=self._nthread)
        flags = self.model.opt.disableflags
        try:
            for disabled, control, states, sensors in self._rollouts:
                control[:] = self._control[:, None]
                self.model.opt.disableflags = flags | disabled
                engine.rollout(
                    self._models,
                    self._threads,
                    self._state,
                    control,
                    nstep=control.shape[1],
                    control_spec=_CONTROL,
                    state=states,
                    sensordata=sensors,
                    skip_checks=True,
                )
                self._state[:] = states[:, -1]
        finally:
            self.model.opt.disableflags = flags
        return self._rollouts[-1].sensors[:, -1]

    def arrays(self) -> dict[str, np.ndarray]:
        return {
            "state": self._state,
            "control": self._control,
            "sensordata": self.sensordata,
            "valid": self.valid,
        }

    def __getstate__(self) -> dict[str, Any]:
        """Returns what an exact copy needs; threads and MuJoCo's scratch space are made anew."""
        threads = {"threads": self._nthread} if self._nthread else {}
        made_from = (self.model, self.task_rules, self.robots), threads
        parts = {"dimensions": self.dimensions, "world": self.world, "state": self.get_state()}
        return {"made_from": made_from, **parts}

    def __setstate__(self, state: dict[str, Any]) -> None:
        arguments, threads = state["made_from"]
        self.__init__(*arguments, **threads)
        self.dimensions = state["dimensions"]
        self.enter(state["world"])
        self.set_state(state["state"])

    def _sound(self, time: np.ndarray) -> np.ndarray:
        # MuJoCo resets an unstable simulation, and rollout stops at a warning: in both cases the
        # clock advances by less than a control step. Comparisons with NaN are false.
        sound = self.dimensions.sound(self._state[:, 1:7])
        sound[:, 0] &= np.abs(self._state[:, 0] - time - CONTROL_TIMESTEP) < 1e-6
        return sound


_BATCHES: weakref.WeakSet[Batch] = weakref.WeakSet()


def _forget_threads() -> None:
    """Makes batches start their own threads in a forked process, which inherits only one.

    The inherited pools are leaked: their destructor would wait for their threads for ever.
    """
    for batch in _BATCHES:
        if batch._nthread and batch._engine is not None:
            ctypes.pythonapi.Py_IncRef(ctypes.py_object(batch._engine))
            batch._engine = None


if hasattr(os, "register_at_fork"):  # not on Windows
    os.register_at_fork(after_in_child=_forget_threads)
