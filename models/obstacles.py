"""Round pillars in the arena."""

from __future__ import annotations

import mujoco

OBSTACLES = ((-0.22, 0.11, 0.05), (0.05, -0.14, 0.06), (0.27, 0.10, 0.04))  # x, y, radius in [m]


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
