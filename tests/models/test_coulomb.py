"""The body at a wall obeys Coulomb's law: MuJoCo's robot against an independent planar oracle.

    PYTHONPATH=tests .venv/bin/python tests/models/test_coulomb.py

prints the errors by timestep, for docs/physics.md.
"""

import functools

import mujoco
import numpy as np
import pytest
from coulomb import GRAVITY, PlanarRobot, closed_form, drive

from musebot.models import Dimensions, arena_spec, robot_pose, robot_qpos
from musebot.models.kinematic import grip

ANGLES = np.array([30, 50, 60, 65, 70, 75, 80, 85, 88])  # from head-on, in [deg]
PAIRS = ((0.5, 0.5), (0.5, 0.4), (0.3, 0.3))
CASES = [(motors, angle) for motors in PAIRS for angle in ANGLES]
STEPS = 20  # control steps of 0.1 s
FLOOR = ("left_wheel", "right_wheel", "front_castor", "back_castor")
HELD = 0.021  # [N], what both castors carry at rest together


# What robots do far from a slip along one wall: motors and start.
DRIVES = {
    "spin": ((-0.5, 0.5), (0, 0, 0)),
    "arc": ((0.5, 0.3), (0, 0, 0)),
    "straight": ((0.5, 0.5), (-0.4, 0.1, 0.3)),
    "arc backwards": ((-0.5, -0.2), (0, 0, 1)),
    "into a corner": ((0.5, 0.5), (0.45, 0.3, 0.7)),
    "against a wall": ((0.5, 0.5), (0.3, 0.0, 0.3)),
}


class Driven:
    """MuJoCo's robots with constant motors, for `STEPS` control steps.

    Attributes:
      poses: x, y in [m] and heading in [rad] at the end of every control step, shape (K, T, 3).
      loads: Mean loads in [N] of the two wheels and the two castors over the second half, (K, 4).
    """

    def __init__(self, motors, start, substeps=None):
        spec = arena_spec()
        spec.option.timestep = 0.1 / substeps if substeps else spec.option.timestep
        model = spec.compile()
        data, substeps = mujoco.MjData(model), round(0.1 / model.opt.timestep)
        geoms, floor = [model.geom(name).id for name in FLOOR], model.geom("floor").id
        self.poses = np.zeros((len(start), STEPS, 3))
        self.loads = np.zeros((len(start), 4))
        force = np.zeros(6)
        for robot, pose in enumerate(start):
            mujoco.mj_resetData(model, data)
            data.qpos[:] = robot_qpos(pose)
            data.ctrl[:] = motors[robot]
            for step in range(STEPS):
                for _ in range(substeps):
                    mujoco.mj_step(model, data)
                    for number in range(data.ncon if step >= STEPS // 2 else 0):
                        pair = data.contact.geom[number]
                        if floor in pair:
                            mujoco.mj_contactForce(model, data, number, force)
                            self.loads[robot, geoms.index(pair[pair != floor][0])] += force[0]
                self.poses[robot, step] = robot_pose(data.qpos)
        self.loads /= STEPS / 2 * substeps


@functools.cache
def planar(motor_speed=None):
    """Returns the planar robot with the numbers of the compiled model."""
    model = arena_spec(motor_speed=motor_speed).compile()
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    inside = np.flatnonzero(model.body_rootid == model.body("robot").id)
    mass, height = model.body_mass[inside], data.xipos[inside, 2]
    robot, wheel, motor = (
        model.body("robot"),
        model.body("left_wheel"),
        model.actuator("left_motor"),
    )
    base, castor = 2 * wheel.pos[1], model.geom("front_castor").pos[0]
    turning = model.body("castors").mass[0] * castor**2 + 2 * wheel.mass[0] * (base / 2) ** 2
    rolling = model.dof_armature[model.joint("left_wheel").dofadr[0]] + wheel.inertia.max()
    axle, gear, gain = wheel.pos[2], motor.gear[0], motor.gainprm[0]
    return PlanarRobot(
        mass=mass.sum(),
        inertia=robot.inertia[2] + turning,
        wheel_mass=rolling / axle**2,
        base=base,
        radius=model.geom("bumper").size[0],
        stall=gear * gain / axle,
        drag=gear**2 * gain / axle**2,
        friction=model.geom("left_wheel").friction[0],
        push=model.geom("bumper").pos[2],
        centre=(mass * height).sum() / mass.sum(),
        castor=castor,
        held=HELD,
    )


@functools.cache
def oracle():
    """Returns motors, starts, poses and loads of robots at a wall, upright ones, and drives."""
    size = Dimensions.of(arena_spec().compile())
    groups = np.repeat(["leaning", "upright", "drive"], [len(CASES), len(ANGLES), len(DRIVES)])
    motors = [motors for motors, _ in CASES] + [PAIRS[0]] * len(ANGLES)
    start = np.full((len(groups), 3), -0.25)
    start[:, 0] = size.half_length - size.radius
    start[: len(motors), 2] = np.radians([*(angle for _, angle in CASES), *ANGLES])
    start[len(motors) :] = [start for _, start in DRIVES.values()]
    motors = np.array(motors + [motors for motors, _ in DRIVES.values()])
    half = size.half_length, size.half_width
    poses, loads = drive(planar(), motors, start, STEPS / 10, half, groups != "upright")
    return {
        name: (motors[own], start[own], np.moveaxis(poses, 0, 1)[own], loads[:, own])
        for name in np.unique(groups)
        for own in [groups == name]
    }


def apart(ours, wanted):
    """Returns the distance in [m] and the angle in [deg] between poses."""
    turn = (ours - wanted)[..., 2]
    turn = np.degrees(np.abs((turn + np.pi) % (2 * np.pi) - np.pi))
    return np.hypot(*np.moveaxis(ours - wanted, -1, 0)[:2]), turn


@pytest.fixture(scope="module", params=[None, 100], ids=["shipped", "1 ms"])
def driven(request):
    return Driven(*oracle()["leaning"][:2], request.param)


def test_the_oracle_slips_as_the_closed_form_of_coulombs_law_says():
    motors, start, poses, loads = oracle()["upright"]
    speed = (poses[:, -1, 1] - poses[:, -6, 1]) / 0.5
    wanted = closed_form(planar(), loads[-1, :, 0], start[:, 2], motors[:, 0])
    np.testing.assert_allclose(speed, wanted, rtol=1e-3, atol=1e-6)
    np.testing.assert_allclose(poses[:, -1, 2], start[:, 2], atol=1e-9)  # it does not turn
    assert (wanted == 0).any() and (wanted > 0.1).any()


def test_a_robot_at_a_wall_slips_and_turns_as_the_oracle(driven):
    _, start, poses, _ = oracle()["leaning"]
    ours, wanted = driven.poses[:, -1] - start, poses[:, -1] - start
    print("motors, angle; slip [mm] and turn [deg], MuJoCo's and the oracle's")
    for case, (_, slip, turn), (_, slips, turns) in zip(CASES, ours, wanted, strict=True):
        mm, degrees = 1000 * np.array([slip, slips]), np.degrees([turn, turns])
        print(*case, mm.round(1), degrees.round(2))
    close = np.maximum(0.003, 0.1 * np.abs(wanted[:, 1]))
    assert (np.abs(ours[:, 1] - wanted[:, 1]) <= close).all()
    assert apart(ours, wanted)[1].max() <= 2


def test_the_wheels_of_a_robot_at_a_wall_carry_what_statics_says(driven):
    wanted = oracle()["leaning"][3][STEPS // 2 :].mean(axis=0)
    print("largest difference of a load:", np.abs(driven.loads[:, :2] / wanted - 1).max())
    np.testing.assert_allclose(driven.loads[:, :2], wanted, rtol=0.15)
    np.testing.assert_allclose(driven.loads.sum(axis=1), planar().mass * GRAVITY, rtol=0.03)


def test_the_loads_at_rest_are_those_of_the_page():
    loads = Driven(np.zeros((1, 2)), np.zeros((1, 3))).loads[0]
    np.testing.assert_allclose(loads[:2], (planar().mass * GRAVITY - HELD) / 2, rtol=0.02)
    np.testing.assert_allclose(loads[2:], HELD / 2, rtol=0.1)
    # What the kinematic simulator's slip holds of it: both tyres' friction over both motors' drag.
    for speed in (None, 0.05, 0.4):
        robot, size = planar(speed), Dimensions.of(arena_spec(motor_speed=speed).compile())
        assert pytest.approx(robot.friction * loads[0] / robot.drag, rel=0.01) == grip(size)


def test_robots_drive_as_the_oracle():
    motors, start, poses, _ = oracle()["drive"]
    distance, turn = (part.max(axis=1) for part in apart(Driven(motors, start).poses, poses))
    for name, *row in zip(DRIVES, 1000 * distance, turn, strict=True):
        print(name, "[mm], [deg]:", np.round(row, 2))
    assert distance.max() < 0.006
    assert turn.max() < 7


def errors_by_timestep():
    """Prints a row for each number of substeps."""
    from test_arena import Motion, random_motors

    print("| substeps | slip [mm] | turn [deg] | drives [mm] | [deg] | wall [mm] | tilt [deg] |")
    for substeps in (100, 20, 14, 13, 12, 10):
        motors, start, poses, _ = oracle()["leaning"]
        wanted, ours = poses[:, -1], Driven(motors, start, substeps).poses[:, -1]
        slip = np.abs(ours - wanted)[:, 1].max()
        motors, start, poses, _ = oracle()["drive"]
        distance, turned = apart(Driven(motors, start, substeps).poses, poses)
        crash = Motion(random_motors(10, 3000), (-0.425, 0.25, 3 * np.pi / 4), substeps)
        row = 1000 * slip, apart(ours, wanted)[1].max(), 1000 * distance.max(), turned.max()
        row = [*row, -1000 * crash.deepest, crash.tilt]
        print("|", substeps, "|", " | ".join(f"{number:.2f}" for number in row), "|")


if __name__ == "__main__":
    errors_by_timestep()
