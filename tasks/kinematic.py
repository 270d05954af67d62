"""Robots in lockstep in the kinematic simulator."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import mujoco
import numpy as np

from ..models import ARENA_XML, Dimensions, Kinematics, add_velocity, hide_spot
from ..models.arrays import namespace
from ..models.kinematic import (
    WALLS,
    distances,
    drive,
    follow_motors,
    gaps,
    grip,
    spot_from_nose,
)
from .arena import Edit, TaskDefinition
from .batch import Robots
from .episode import CONTROL_TIMESTEP
from .rules import Rules, SensorLayout
from .sensors import NoseForm
from .suite import task_definition


class KinematicBatch(Robots):
    """B ideal differential drives, each alone in its arena (see `models.kinematic`).

    Attributes:
      kinematics: Settings of the simulator: body, walls, contact, lag and path.
      velocity: Index of the speed ahead in `sensordata`; None for robots that do not sense it.
      compiled: Whether Numba computes the steps, see `compile`.
    """

    def __init__(
        self, model: mujoco.MjModel, rules: Rules, robots: int, kinematics: Kinematics
    ) -> None:
        """Places B robots at the origin, see `Robots` and `make_kinematic_batch`."""
        dimensions = kinematics.applied_to(Dimensions.of(model))
        super().__init__(robots, rules, dimensions, model.nsensordata)
        self.kinematics = kinematics
        self._poses = np.zeros((robots, 3))
        self._spots = np.tile(model.body("spot").pos[:2], (robots, 1))
        self._wheels = np.zeros((robots, 2))  # speeds of the wheels, in motor values
        self._touch = np.zeros(robots)
        sensor = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_SENSOR, "velocity")
        self.velocity = int(model.sensor_adr[sensor]) if sensor >= 0 else None
        self.compiled = False
        self.place(np.arange(robots), self._poses)

    def compile(self) -> None:
        """Lets Numba compute the next steps, if its equations fit the sensors of these robots."""
        from .. import compiled_equations as equations

        layout = self.rules.layout
        places = layout.distances.start, layout.touch.start, layout.smell.start
        if places == (equations.DISTANCES, equations.TOUCH, equations.SMELL):
            self.compiled = True
            self._numbers = numbers_of(self.dimensions, self.kinematics)

    def compiled_arguments(self) -> tuple[Any, Any, Any]:
        """Returns what the compiled equations read: a `Body`, a `Motion`, and a tuple of arrays."""
        state = self._poses, self._wheels, self._touch, self._spots, self.sensordata, self.valid
        return *self._numbers, state

    @property
    def pose(self) -> np.ndarray:
        return self._poses.copy()

    @property
    def spot(self) -> np.ndarray:
        return self._spots.copy()

    def place(self, robots: np.ndarray, poses: np.ndarray) -> None:
        robots, poses = self._placed(robots, poses, "poses", 3)
        inside = self.dimensions.sound(poses[:, :2]).all(axis=1)
        sound = inside & np.isfinite(poses[:, 2])
        self.valid[robots[~sound]] = False
        self._poses[robots] = np.where(sound[:, None], poses, 0.0)
        self._wheels[robots] = 0
        near = self.kinematics.felt == "near"
        self._touch[robots] = touches(self._poses[robots], self.dimensions) if near else 0
        sensed = np.zeros((len(robots), self.sensordata.shape[1]))
        world = self._poses[robots], self._spots[robots], self._touch[robots]
        measure(sensed, self.rules.layout, world, self.dimensions)
        self.sensordata[robots] = np.where(self.valid[robots, None], sensed, 0)

    def place_spot(self, robots: np.ndarray, spots: np.ndarray) -> None:
        robots, spots = self._placed(robots, spots, "spots", 2)
        self._spots[robots] = spots

    def step(self, motors: np.ndarray) -> None:
        motors = np.clip(self._finite_motors(motors), -0.5, 0.5)
        before = self._poses.copy()
        if self.compiled:
            from ..compiled_equations import move_all

            move_all(*self.compiled_arguments(), motors)
        else:
            self._poses[:], self._wheels[:], self._touch[:] = after_control_step(
                before, self._wheels, motors, self.kinematics, self.dimensions
            )
            world = self._poses, self._spots, self._touch
            measure(self.sensordata, self.rules.layout, world, self.dimensions)
        measure_speed(self.sensordata, self.velocity, before, self._poses)
        self._stop_unsound(self.dimensions.sound(self._poses[:, :2]))

    def arrays(self) -> dict[str, np.ndarray]:
        return {
            "poses": self._poses,
            "spots": self._spots,
            "wheels": self._wheels,
            "touch": self._touch,
            "sensordata": self.sensordata,
            "valid": self.valid,
        }


def after_control_step(
    poses: np.ndarray, wheels: np.ndarray, motors: np.ndarray, how: Kinematics, size: Dimensions
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Moves robots for a control step of 0.1 s, see `models.kinematic.drive`.

    Returns:
      Poses, shape (B, 3), and speeds of the wheels in motor values, shape (B, 2), at the end; and
      whether each robot is in contact, shape (B,).
    """
    contact: Any = False
    piece = CONTROL_TIMESTEP / how.pieces
    for number in range(how.pieces):
        speeds, wheels = follow_motors(wheels, motors, piece, how.lag)
        poses, pushing = drive(poses, speeds, piece, how, size)
        if how.any_contact or number == how.pieces - 1:
            contact = contact | (pushing if how.felt == "pushed" else touches(poses, size))
    return poses, wheels, contact


def numbers_of(size: Dimensions, how: Kinematics) -> tuple[Any, Any]:
    """Returns the `Body` and the `Motion` of the compiled equations."""
    from ..compiled_equations import Body, Motion

    body = {
        "length": size.half_length - size.radius,
        "width": size.half_width - size.radius,
        "wheel_base": size.wheel_base,
        "speed": 2 * size.motor_speed,
        "radius": size.radius,
        "nose": size.nose,
        "margin": size.contact_margin,
    }
    seconds = CONTROL_TIMESTEP / how.pieces
    late, behind = follow_motors(np.ones((1, 2)), np.zeros((1, 2)), seconds, how.lag)
    motion = Motion(
        wall=WALLS.index(how.wall),
        pushed=how.felt == "pushed",
        any_contact=how.any_contact,
        arc=how.path == "arc",
        seconds=seconds,
        pieces=how.pieces,
        late=float(late[0, 0]),
        behind=float(behind[0, 0]),
        grip=grip(size),
    )
    return Body(**{name: float(value) for name, value in body.items()}), motion


def touches(poses: np.ndarray, size: Dimensions) -> np.ndarray:
    """Returns whether the gap between rim and wall is within the contact margin, shape (B,)."""
    return gaps(poses, size) <= size.contact_margin


def measure_speed(
    sensordata: np.ndarray, velocity: int | None, before: np.ndarray, after: np.ndarray
) -> None:
    """Writes the mean speed of a control step along the final heading, in [m/s], if it is sensed.

    The poses before and after the step have the shape (B, 3).
    """
    if velocity is not None:
        xp, (x, y) = namespace(after), (after[:, :2] - before[:, :2]).T
        ahead = x * xp.cos(after[:, 2]) + y * xp.sin(after[:, 2])
        sensordata[:, velocity] = ahead / CONTROL_TIMESTEP


def measure(
    sensordata: np.ndarray,
    layout: SensorLayout,
    world: tuple[np.ndarray, np.ndarray, np.ndarray],
    size: Dimensions,
) -> None:
    """Writes what robots measure into `sensordata`, at the indices in `layout`.

    `world` has their poses, (B, 3), the centres of their spots, (B, 2), and contacts, (B,).
    """
    poses, spots, touch = world
    sensordata[:, layout.distances] = distances(poses, size)
    sensordata[:, layout.touch] = touch[:, None]
    first = layout.smell.start
    sensordata[:, first : first + 2] = spot_from_nose(poses, spots, size)


def kinematic_definition(task_name: str) -> TaskDefinition:
    """Returns a task's definition; ValueError unless its robot and arena are the paper's.

    The kinematic simulator has no pillars and no second nose.
    """
    definition = task_definition(task_name)
    if definition.model != ARENA_XML or not {*definition.edits} <= {hide_spot, add_velocity}:
        raise ValueError(
            f"the kinematic simulator has the paper's robot and arena only, unlike {task_name}"
        )
    return definition


def make_kinematic_batch(
    task_name: str,
    robots: int,
    kinematics: Kinematics,
    *,
    nose: NoseForm = "inverse",
    motor_speed: float | None = None,
    edits: Sequence[Edit] = (),
) -> KinematicBatch:
    """Returns robots in lockstep in the kinematic simulator, with a task's sensors.

    The arguments are those of `make_batch`, with `kinematics` in place of `threads`. Edits have
    an effect only if they change the model's `Dimensions` or add the sensor `velocity`.

    Raises ValueError for a task that `kinematic_definition` refuses, or a value out of range.
    """
    definition = kinematic_definition(task_name)
    model = definition.spec(motor_speed, edits).compile()
    return KinematicBatch(model, definition.rules.of(model, nose), robots, kinematics)
