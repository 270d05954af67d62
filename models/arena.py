"""How the robot and its arena are read: MJCF in, a compiled model and its dimensions out.

The numbers stand in `robot.xml` and `arena.xml` alone. `arena_spec` edits a few of them for
experiments, and `Dimensions.of` reads back from a compiled model whatever Python needs.
"""

from __future__ import annotations

import dataclasses
from pathlib import Path

import mujoco
import numpy as np

ROBOT_XML = Path(__file__).with_name("robot.xml")
ARENA_XML = Path(__file__).with_name("arena.xml")

# dm_control 1.0.50 reads fields of MjModel that MuJoCo renames at nearly every release.
_MUJOCO = (3, 17)


def check_versions() -> None:
    """Raises ImportError, in one sentence, where this MuJoCo does not go with dm_control."""
    if tuple(int(part) for part in mujoco.__version__.split(".")[:2]) != _MUJOCO:
        wanted = ".".join(map(str, _MUJOCO))
        raise ImportError(
            f"musebot needs MuJoCo {wanted}.x, because dm_control breaks with others; "
            f"got {mujoco.__version__} (pip install 'mujoco~={wanted}.0')"
        )


def arena_spec(*, motor_speed: float | None = None) -> mujoco.MjSpec:
    """Returns the arena with its robot as an editable MjSpec; `.compile()` makes the model.

    Args:
      motor_speed: speed of a wheel at motor value 0.5, in metres a second; None leaves
        that of `robot.xml`.

    Raises:
      ImportError: this MuJoCo does not go with dm_control.
      ValueError: the speed is not positive.
    """
    check_versions()
    spec = mujoco.MjSpec.from_file(str(ARENA_XML))
    if motor_speed is not None:
        if not motor_speed > 0:
            raise ValueError(f"motor_speed must be positive, got {motor_speed}")
        # A gear is motor value over wheel speed, and torque = gear * gain * (motor value - gear *
        # wheel speed): the gain keeps the torque of a stalled wheel what it was.
        for motor in spec.actuators:
            radius = spec.geom(motor.target).size[0]
            gear = 0.5 * radius / motor_speed
            scale = motor.gear[0] / gear
            motor.gear[0] = gear
            motor.gainprm[0] *= scale
            motor.biasprm[2] *= scale
    return spec


def robot_qpos(pose: np.ndarray) -> np.ndarray:
    """Generalised positions of a robot standing on the floor, wheels at angle zero.

    Args:
      pose: x, y in metres and heading in radians (0 looks along +x), shape (..., 3).

    Returns:
      Position, quaternion and the two wheel angles, shape (..., 9).
    """
    pose = np.asarray(pose, dtype=float)
    qpos = np.zeros((*pose.shape[:-1], 9))
    qpos[..., :2] = pose[..., :2]
    qpos[..., 3] = np.cos(pose[..., 2] / 2)
    qpos[..., 6] = np.sin(pose[..., 2] / 2)
    return qpos


def robot_pose(qpos: np.ndarray) -> np.ndarray:
    """The inverse of `robot_qpos`: x, y and heading, shape (..., 3), from (..., 9)."""
    x, y, _, w, i, j, k = np.moveaxis(qpos[..., :7], -1, 0)
    return np.stack([x, y, np.arctan2(2 * (w * k + i * j), 1 - 2 * (j * j + k * k))], axis=-1)


def half_size(arena: mujoco.MjModel | mujoco.MjSpec) -> tuple[float, float]:
    """Half of the arena along x and along y, in metres; compiled or not."""
    return float(arena.geom("east").pos[0]), float(arena.geom("north").pos[1])


@dataclasses.dataclass(frozen=True)
class Dimensions:
    """What Python needs to know of a compiled arena. SI units.

    Attributes:
      half_length: half of the arena along x, in metres.
      half_width: half of the arena along y, in metres.
      radius: the robot's, in metres.
      wheel_base: distance between the wheels, in metres.
      motor_speed: speed of a wheel at motor value 0.5, in metres a second.
      contact_margin: the gap to a wall at which the rim feels it, in metres.
      spot_radius: of the odorous spot, in metres.
      obstacles: of each, x, y and radius, in metres.
    """

    half_length: float
    half_width: float
    radius: float
    wheel_base: float
    motor_speed: float
    contact_margin: float
    spot_radius: float
    obstacles: tuple[tuple[float, float, float], ...] = ()

    @classmethod
    def of(cls, model: mujoco.MjModel) -> Dimensions:
        """Reads the dimensions of a compiled arena with its robot.

        Raises:
          KeyError: a body, geom, site or actuator of the arena is missing.
        """
        bumper = model.geom("bumper")
        wheel_radius = float(model.geom("left_wheel").size[0])
        half_length, half_width = half_size(model)
        return cls(
            half_length=half_length,
            half_width=half_width,
            radius=float(bumper.size[0]),
            wheel_base=float(model.body("left_wheel").pos[1] - model.body("right_wheel").pos[1]),
            motor_speed=float(0.5 * wheel_radius / model.actuator("left_motor").gear[0]),
            contact_margin=float(bumper.margin[0]),
            spot_radius=float(model.site("spot").size[0]),
            obstacles=tuple(
                (float(body.pos[0]), float(body.pos[1]), float(model.geom(body.name).size[0]))
                for body in map(model.body, range(model.nbody))
                if body.name.startswith("obstacle")
            ),
        )
