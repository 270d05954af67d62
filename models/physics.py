"""MuJoCo's physics of the arena in dm_control: places, pictures, states and copies."""

from __future__ import annotations

import copy
import math
import operator
from typing import Any, Self

import mujoco as mj
import numpy as np

# First: it imports dm_control without its warnings.
from .rendering import check_process, fit_buffer, open_context

# isort: split
from dm_control import mujoco
from dm_control.mujoco.engine import Contexts
from dm_control.mujoco.wrapper import MjData, MjrContext
from dm_control.rl import control

from .arena import Dimensions, robot_pose, robot_qpos

_SENSORS = mj.mjtDisableBit.mjDSBL_SENSOR.value
INTEGRATION = mj.mjtState.mjSTATE_INTEGRATION.value  # everything that a physics step depends on


class Physics(mujoco.Physics):
    """dm_control's `Physics` for the arena, with methods that place the robot and the spot.

    After `step`, `sensordata` shows the start of the last substep (docs/physics.md), as in the
    batch of robots. Copies, also through pickle, continue bit-exactly.

    Attributes:
      dimensions: Dimensions of robot, arena and spot, read from the model.
      qpos: View of MuJoCo's qpos, shape (nq,).
      readings: View of MuJoCo's sensordata, shape (1, nsensordata).
    """

    def step(self, nstep: int = 1) -> None:
        """Simulates substeps, of which only the last evaluates sensors, as in the batch.

        The solver has no warm start in the first and the last substep, so that results depend on
        the state alone. A step sets flags of the model: copies that share a model must share a
        thread.
        """
        model, data = self.model.ptr, self.data.ptr
        flags = model.opt.disableflags
        with self.check_invalid_state():
            try:
                for steps, disabled in ((nstep - 1, _SENSORS), (1, 0)):
                    data.qacc_warmstart[:] = 0
                    model.opt.disableflags = flags | disabled
                    mj.mj_step(model, data, steps)
            finally:
                model.opt.disableflags = flags
        # MuJoCo leaves places of bodies, cameras and lights as they were before the last substep.
        for update in (mj.mj_kinematics, mj.mj_comPos, mj.mj_camlight):
            update(model, data)

    def robot_pose(self) -> np.ndarray:
        """Returns the robot's x, y in [m] and heading in [rad], shape (3,)."""
        return robot_pose(self.data.qpos)

    def spot_position(self) -> np.ndarray:
        """Returns x, y of the spot's centre in [m], shape (2,)."""
        return self._spot.copy()

    def place_robot(self, x: float, y: float, heading: float) -> None:
        """Places the robot at rest at x, y in [m], with a heading in [rad]."""
        self.data.qpos[:] = robot_qpos(np.array([x, y, heading]))
        self.data.qvel[:] = 0
        self.data.ctrl[:] = 0

    def place_spot(self, x: float, y: float) -> None:
        """Places the spot's centre at x, y in [m]; sensors show it from the next step on."""
        self._spot[:] = x, y
        mj.mj_kinematics(self.model.ptr, self.data.ptr)  # for pictures

    def render(self, height: int = 240, width: int = 320, *args: Any, **kwargs: Any) -> np.ndarray:
        """Returns dm_control's picture of a camera; the model's buffer grows to fit it.

        Raises RuntimeError where OpenGL cannot be opened, or the environment is closed.
        """
        if not self.qpos.size:
            raise RuntimeError("the environment is closed")
        check_process()
        fit_buffer(self.model.ptr, width, height)
        if self._contexts:
            size, context = self.model.vis.global_, self._contexts.mujoco.ptr
            if context.offWidth < width or context.offHeight < height:
                with self._contexts.gl.make_current() as executor:
                    executor.call(mj.mjr_resizeOffscreen, size.offwidth, size.offheight, context)
        return super().render(height, width, *args, **kwargs)

    def _make_rendering_contexts(self) -> None:
        size = self.model.vis.global_
        gl = open_context(size.offwidth, size.offheight)
        self._contexts = Contexts(gl=gl, mujoco=MjrContext(self.model, gl))

    def check_sound(self) -> None:
        """Raises PhysicsError where a batch would stop the robot, see `Robots.valid`.

        It is then outside the arena, above the floor or tilted, or its sensors are not finite.
        """
        place = self.qpos.tolist()[:6]
        if not all(map(operator.lt, map(abs, place), self._bounds)):
            x, y, z = place[:3]
            raise control.PhysicsError(
                f"the simulation became unstable: the robot is at x {x:g}, y {y:g}, z {z:g} m"
            )
        if not math.isfinite(sum(self.readings[0].tolist())):
            raise control.PhysicsError(
                f"the simulation became unstable: the sensors read {self.readings[0].tolist()}"
            )

    def restore(self, state: np.ndarray, sensordata: np.ndarray) -> None:
        """Restores what `get_state(INTEGRATION)` and `data.sensordata` returned."""
        self.set_state(state, INTEGRATION)
        self.forward()  # for pictures; what it overwrites is restored below
        self.set_state(state, INTEGRATION)
        self.data.sensordata[:] = sensordata

    def copy(self, share_model: bool = False) -> Self:
        twin = super().copy(share_model)
        mj.mj_copyData(twin.data.ptr, twin.model.ptr, self.data.ptr)
        return twin

    def __setstate__(self, data: MjData) -> None:
        """Restores a pickled or copied physics."""
        kept = copy.copy(data.ptr)  # the parent's forward pass overwrites what the last step left
        super().__setstate__(data)
        mj.mj_copyData(self.data.ptr, self.model.ptr, kept)

    def free(self) -> None:
        """Frees the renderer and MuJoCo's data; the physics cannot be used any more."""
        super().free()
        self.qpos = self.readings = self._spot = np.zeros(0)

    def _reload_from_data(self, data: MjData) -> None:
        super()._reload_from_data(data)
        self.dimensions = Dimensions.of(self.model.ptr)
        self._bounds = self.dimensions.bounds.tolist()
        self.qpos = self.data.qpos
        self.readings = self.data.sensordata[None]
        self._spot = self.data.mocap_pos[0, :2]
