"""Edits of the arena for further tasks: sensors, pillars, the motors' torque, a hidden spot.

This module holds the dimensions of what is added; the XML files hold those of robot and arena.
"""

from __future__ import annotations

import mujoco
import numpy as np

from .arena import arena_spec

OBSTACLES = ((-0.22, 0.11, 0.05), (0.05, -0.14, 0.06), (0.27, 0.10, 0.04))  # x, y, radius in [m]
NOSE_ANGLE = np.pi / 6  # [rad] from the front, at which each of two noses sits and points


def hide_spot(spec: mujoco.MjSpec) -> None:
    """Makes the spot invisible, for tasks without a spot."""
    spec.material("spot").rgba[3] = 0


def centre_nose(spec: mujoco.MjSpec) -> None:
    """Moves the nose from the front of the rim to the robot's centre."""
    spec.site("nose").pos[0] = 0


def scale_torque(spec: mujoco.MjSpec) -> None:
    """Scales the motors' torque with their speed, so that the wheels' lag is that of `arena.xml`.

    Without this edit `arena_spec` leaves the torque of a stalled wheel unchanged: a motor of twice
    the speed then brakes half as much, and the wheels take twice as long to follow the motor.
    """
    for motor, own in zip(spec.actuators, arena_spec().actuators, strict=True):
        faster = own.gear[0] / motor.gear[0]
        motor.gainprm[0] *= faster
        motor.biasprm[2] *= faster


def add_velocity(spec: mujoco.MjSpec) -> None:
    """Adds a sensor of the robot's velocity: ahead, left, up, in [m/s]."""
    spec.add_sensor(
        name="velocity",
        type=mujoco.mjtSensor.mjSENS_VELOCIMETER,
        objtype=mujoco.mjtObj.mjOBJ_SITE,
        objname="rim",
    )


def add_noses(spec: mujoco.MjSpec) -> None:
    """Adds a nose to the left and one to the right of the front, facing outwards.

    The nose in front stays as the point that must be inside the spot, but gives no signal.
    """
    front = spec.site("nose")
    front.group = 4
    radius = front.pos[0]
    for name, angle in (("left", NOSE_ANGLE), ("right", -NOSE_ANGLE)):
        spec.body("robot").add_site(
            name=f"{name}_nose",
            type=mujoco.mjtGeom.mjGEOM_SPHERE,
            size=front.size,
            pos=[radius * np.cos(angle), radius * np.sin(angle), front.pos[2]],
            quat=[np.cos(angle / 2), 0, 0, np.sin(angle / 2)],
            material=front.material,
        )
        spec.add_sensor(
            name=f"{name}_smell",
            type=mujoco.mjtSensor.mjSENS_FRAMEPOS,
            objtype=mujoco.mjtObj.mjOBJ_XBODY,
            objname="spot",
            reftype=mujoco.mjtObj.mjOBJ_SITE,
            refname=f"{name}_nose",
        )


def add_obstacles(spec: mujoco.MjSpec) -> None:
    """Adds three round pillars, as high as the walls."""
    bumper = spec.geom("bumper")
    for number, (x, y, radius) in enumerate(OBSTACLES, start=1):
        body = spec.worldbody.add_body(name=f"obstacle_{number}", pos=[x, y, 0])
        # Visible to cameras and rangefinders; no contacts.
        body.add_geom(
            name=f"obstacle_{number}",
            type=mujoco.mjtGeom.mjGEOM_CYLINDER,
            size=[radius, 0.025, 0],
            pos=[0, 0, 0.025],
            contype=0,
            conaffinity=0,
            material="wall",
        )
        # Contacts: a ball at the height of the bumper pushes only sideways, and MuJoCo's collision
        # of ball and cylinder is exact. A rangefinder inside the pillar hits the ball.
        body.add_geom(
            name=f"obstacle_{number}_core",
            type=mujoco.mjtGeom.mjGEOM_SPHERE,
            size=[radius, 0, 0],
            pos=[0, 0, bumper.pos[2]],
            contype=0,
            conaffinity=1,
            group=3,
            material="wall",
        )
