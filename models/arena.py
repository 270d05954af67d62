"""Loading of robot and arena: from MJCF to a compiled model and its dimensions.

`robot.xml` and `arena.xml` hold every dimension. `arena_spec` edits the motors for experiments;
`Dimensions.of` reads the dimensions that Python code needs from a compiled model.
"""

from __future__ import annotations

import dataclasses
import functools
import math
import numbers
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

ROBOT_XML = Path(__file__).with_name("robot.xml")
ARENA_XML = Path(__file__).with_name("arena.xml")

# dm_control 1.0.50 reads fields of MjModel that MuJoCo renames in almost every release.
_MUJOCO = (3, 17)

# Bounds: several times the height and tilt of robots that drive into walls and obstacles.
_HEIGHT = 0.01  # [m]
_TILT = math.sin(math.radians(20) / 2)  # of the quaternion's i and j
SLOWEST, FASTEST = 0.001, 10  # [m/s]; smallest and largest `motor_speed`


def check_versions() -> None:
    """Raises ImportError if the installed MuJoCo does not work with dm_control."""
    if tuple(int(part) for part in mujoco.__version__.split(".")[:2]) != _MUJOCO:
        wanted = ".".join(map(str, _MUJOCO))
        raise ImportError(
            f"musebot needs MuJoCo {wanted}.x, because dm_control fails with others, "
            f"got {mujoco.__version__} (pip install 'mujoco~={wanted}.0')"
        )


def arena_spec(path: str | Path = ARENA_XML, *, motor_speed: float | None = None) -> mujoco.MjSpec:
    """Returns the arena with its robot as an editable MjSpec; `.compile()` makes the model.

    Args:
      path: MJCF file of an arena with its robot; see `check_arena` for what it must hold.
      motor_speed: Speed of a wheel at motor value 0.5, in [0.001, 10] m/s; None keeps the file's.

    Raises ValueError for a speed out of this range or a file that cannot be read.
    """
    check_versions()
    spec = mujoco.MjSpec.from_file(str(path))
    if motor_speed is not None:
        number = isinstance(motor_speed, numbers.Real) and not isinstance(motor_speed, bool)
        if not number or not SLOWEST <= motor_speed <= FASTEST:
            raise ValueError(
                f"motor_speed must be a number in [{SLOWEST}, {FASTEST}] m/s, "
                f"got {motor_speed!r:.60}"
            )
        # gear = motor value / wheel speed; torque = gear * gain * (motor value - gear * wheel
        # speed). The gain is scaled to leave the torque of a stalled wheel unchanged.
        for motor in spec.actuators:
            radius = spec.body("left_wheel").pos[2]  # the axle's height: the loaded tyre's radius
            gear = 0.5 * radius / motor_speed
            scale = motor.gear[0] / gear
            motor.gear[0] = gear
            motor.gainprm[0] *= scale
            motor.biasprm[2] *= scale
    return spec


def check_arena(model: mujoco.MjModel) -> None:
    """Raises ValueError unless a compiled arena has what the tasks place, drive and measure.

    The arena must have no other joints, actuators or mocap bodies. `Rules.of` checks the sensors.
    """
    for kind, names in _NEEDED.items():
        for name in names:
            if mujoco.mj_name2id(model, kind, name) < 0:
                what = kind.name.removeprefix("mjOBJ_").lower()
                raise ValueError(f"the arena must have a {what} {name!r}, got none")
    robot = model.body("robot")
    if model.nq != 9 or robot.jntnum[0] != 1 or model.jnt_type[robot.jntadr[0]] != 0:
        raise ValueError(
            "the joints of the arena must be the robot's free joint and two wheels, got "
            f"{[model.joint(number).name for number in range(model.njnt)]}"
        )
    motors = [model.actuator(number).name for number in range(model.nu)]
    if motors != ["left_motor", "right_motor"]:
        raise ValueError(f"the actuators must be left_motor and right_motor, got {motors}")
    for number, name in enumerate(("left_wheel", "right_wheel")):
        wheel = model.body(name)
        if wheel.jntnum[0] != 1 or model.jnt_type[wheel.jntadr[0]] != mujoco.mjtJoint.mjJNT_HINGE:
            raise ValueError(f"the body {name!r} must have one joint, a hinge")
        if model.actuator_trnid[number, 0] != wheel.jntadr[0]:
            raise ValueError(f"{motors[number]} must drive the joint of the body {name!r}")
        if not model.actuator_gear[number, 0] > 0:
            gear = model.actuator_gear[number, 0]
            raise ValueError(f"the gear of {motors[number]} must be positive, got {gear:g}")
    if model.nmocap != 1 or model.body("spot").mocapid[0] != 0:
        raise ValueError("the body 'spot' must be the arena's only mocap body")


_NEEDED = {
    mujoco.mjtObj.mjOBJ_BODY: ("robot", "left_wheel", "right_wheel", "spot"),
    mujoco.mjtObj.mjOBJ_GEOM: ("bumper", "east", "north"),
    mujoco.mjtObj.mjOBJ_SITE: ("nose", "spot"),
    mujoco.mjtObj.mjOBJ_CAMERA: ("overhead",),
}


def robot_qpos(pose: np.ndarray) -> np.ndarray:
    """Returns MuJoCo's qpos of robots on the floor with both wheels at angle 0.

    `pose` is x, y in [m] and heading in [rad] (0 along +x), shape (..., 3). The qpos is position in
    [m], quaternion and wheel angles in [rad], shape (..., 9).
    """
    pose = np.asarray(pose, dtype=float)
    qpos = np.zeros((*pose.shape[:-1], 9))
    qpos[..., :2] = pose[..., :2]
    qpos[..., 3] = np.cos(pose[..., 2] / 2)
    qpos[..., 6] = np.sin(pose[..., 2] / 2)
    return qpos


def robot_pose(qpos: np.ndarray) -> np.ndarray:
    """Returns the poses of robots, shape (..., 3); the inverse of `robot_qpos`."""
    pose = np.empty((*qpos.shape[:-1], 3))
    pose[..., :2] = qpos[..., :2]
    pose[..., 2] = heading(*(qpos[..., number] for number in range(3, 7)))
    return pose


def heading(w: Any, i: Any, j: Any, k: Any) -> Any:
    """Returns the heading in [rad] of a quaternion: the x axis as seen from above."""
    return np.arctan2(2 * (w * k + i * j), 1 - 2 * (j * j + k * k))


def half_size(arena: mujoco.MjModel | mujoco.MjSpec) -> tuple[float, float]:
    """Returns half of the arena's length, along x, and half of its width, along y, in [m]."""
    return float(arena.geom("east").pos[0]), float(arena.geom("north").pos[1])


@dataclasses.dataclass(frozen=True)
class Dimensions:
    """Dimensions of robot, arena and spot, read from a compiled arena.

    Attributes:
      half_length: Half of the arena's length, along x, in [m].
      half_width: Half of the arena's width, along y, in [m].
      radius: Radius of the robot in [m].
      wheel_base: Distance between the wheels in [m].
      motor_speed: Speed of a wheel at motor value 0.5 in [m/s].
      contact_margin: Largest gap to a wall in [m] at which the rim is in contact.
      spot_radius: Radius of the odorous spot in [m].
      nose: Distance from the robot's centre forward to the nose in [m]; 0 if it is at the centre.
      obstacles: Centre x, y and radius of each obstacle in [m].
    """

    half_length: float
    half_width: float
    radius: float
    wheel_base: float
    motor_speed: float
    contact_margin: float
    spot_radius: float
    nose: float
    obstacles: tuple[tuple[float, float, float], ...] = ()

    @functools.cached_property
    def bounds(self) -> np.ndarray:
        """Bounds of the magnitudes of x, y, z in [m] and of w, i, j of the quaternion, shape (6,).

        They hold for a robot inside the arena, on the floor and upright.
        """
        return np.array([self.half_length, self.half_width, _HEIGHT, 2.0, _TILT, _TILT])

    def sound(self, places: np.ndarray) -> np.ndarray:
        """Returns which of the first n <= 6 numbers of qpos, (B, n), are in bounds; NaN is not."""
        return np.abs(places) < self.bounds[: places.shape[1]]

    def check_standing(self, states: np.ndarray, *others: np.ndarray) -> None:
        """Raises ValueError unless robots stand in the arena, and all numbers are finite.

        Each row of `states`, shape (B, n), begins with time and qpos.
        """
        finite = all(np.isfinite(one).all() for one in (states, *others))
        if not (finite and self.sound(states[:, 1:7]).all()):
            raise ValueError(
                "state must be finite numbers, of robots that stand in the arena, got x, y, z "
                f"{states[:, 1:4].tolist()!r:.200}"
            )

    @classmethod
    def of(cls, model: mujoco.MjModel) -> Dimensions:
        """Reads the dimensions of a compiled arena with its robot.

        Raises KeyError where the arena lacks a body, geom, site or actuator; ValueError where an
        obstacle has no geom, lies in another body, or has its largest geom off its centre.
        """
        bumper = model.geom("bumper")
        wheel_radius = float(model.body("left_wheel").pos[2])  # the loaded tyre's radius
        half_length, half_width = half_size(model)
        return cls(
            half_length=half_length,
            half_width=half_width,
            radius=float(bumper.size[0]),
            wheel_base=float(model.body("left_wheel").pos[1] - model.body("right_wheel").pos[1]),
            motor_speed=float(0.5 * wheel_radius / model.actuator("left_motor").gear[0]),
            contact_margin=float(bumper.margin[0]),
            spot_radius=float(model.site("spot").size[0]),
            nose=float(model.site("nose").pos[0]),
            obstacles=tuple(
                (float(body.pos[0]), float(body.pos[1]), _widest(model, body.id))
                for body in map(model.body, range(model.nbody))
                if body.name.startswith("obstacle")
            ),
        )


def _widest(model: mujoco.MjModel, body: int) -> float:
    """Returns the radius of a round body in [m]: the largest `size[0]` of its geoms."""
    own, name = np.flatnonzero(model.geom_bodyid == body), model.body(body).name
    if not len(own):
        raise ValueError(f"the obstacle {name!r} has no geom")
    largest = own[model.geom_size[own, 0].argmax()]
    if model.body_parentid[body] != 0 or np.abs(model.geom_pos[largest, :2]).max() > 1e-9:
        raise ValueError(
            f"the obstacle {name!r} must be a body of the world whose largest geom is at its centre"
        )
    return float(model.geom_size[largest, 0])
