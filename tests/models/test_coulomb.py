"""The body at a wall obeys Coulomb's law: MuJoCo's robot against an independent planar oracle."""

import mujoco
import numpy as np
import pytest
from coulomb import GRAVITY, PlanarRobot, closed_form, drive

from musebot.models import Dimensions, arena_spec, robot_pose, robot_qpos

ANGLES = np.array([30, 50, 60, 65, 70, 75, 80, 85, 88])  # from head-on, in [deg]
PAIRS = ((0.5, 0.5), (0.5, 0.4), (0.3, 0.3))
STEPS = 20  # control steps of 0.1 s
FLOOR = ("left_wheel", "right_wheel", "front_castor", "back_castor")
HELD = 0.021  # [N], what both castors carry at rest together


class Driven:
    """MuJoCo's robots with constant motors, for `STEPS` control steps.

    Attributes:
      poses: x, y in [m] and heading in [rad] at the end of every control step, shape (K, T, 3).
      loads: Mean loads in [N] of the two wheels and the two castors over the second half, (K, 4).
    """

    def __init__(self, motors, start, substeps):
        spec = arena_spec()
        if substeps is not None:
            spec.option.timestep = 0.1 / substeps
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
            for substep in range(STEPS * substeps):
                mujoco.mj_step(model, data)
                for number, contact in enumerate(data.contact):
                    if substep >= STEPS * substeps / 2 and floor in contact.geom:
                        mujoco.mj_contactForce(model, data, number, force)
                        geom = geoms.index(contact.geom[contact.geom != floor][0])
                        self.loads[robot, geom] += force[0]
                if (substep + 1) % substeps == 0:
                    self.poses[robot, substep // substeps] = robot_pose(data.qpos)
        self.loads /= STEPS * substeps / 2


def at_the_east_wall(degrees, size):
    start = np.full((len(degrees), 3), -0.25)
    start[:, 0] = size.half_length - size.radius
    start[:, 2] = np.radians(degrees)
    return start


@pytest.fixture(scope="module")
def size():
    return Dimensions.of(arena_spec().compile())


@pytest.fixture(scope="module")
def planar():
    """The planar robot with the numbers of the compiled model."""
    model = arena_spec().compile()
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    inside = np.flatnonzero(model.body_rootid == model.body("robot").id)
    mass, height = model.body_mass[inside], data.xipos[inside, 2]
    robot, wheel, motor = model.body("robot"), model.body("left_wheel"), model.actuator("left_motor")
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


@pytest.fixture(scope="module")
def grazing(planar, size):
    """The motors of every case at a wall, and what the oracle says: poses and wheels' loads."""
    motors = np.repeat(PAIRS, len(ANGLES), axis=0)
    start = at_the_east_wall(np.tile(ANGLES, len(PAIRS)), size)
    half = size.half_length, size.half_width
    return motors, start, *drive(planar, motors, start, STEPS / 10, half)


@pytest.fixture(scope="module", params=[None, 100], ids=["shipped", "1 ms"])
def driven(request, grazing):
    return Driven(*grazing[:2], request.param)


def test_the_oracle_slips_as_the_closed_form_of_coulombs_law_says(planar, size):
    start = at_the_east_wall(ANGLES, size)
    half = size.half_length, size.half_width
    motors = np.full((len(ANGLES), 2), 0.5)
    poses, loads = drive(planar, motors, start, 2.0, half, lean=False)
    speed = (poses[-1, :, 1] - poses[-6, :, 1]) / 0.5
    wanted = closed_form(planar, loads[-1, :, 0], start[:, 2], 0.5)
    np.testing.assert_allclose(speed, wanted, rtol=1e-3, atol=1e-6)
    np.testing.assert_allclose(poses[-1, :, 2], start[:, 2], atol=1e-9)  # it does not turn
    assert (wanted == 0).any() and (wanted > 0.1).any()


def test_a_grazing_robot_slips_as_the_oracle(grazing, driven):
    wanted = grazing[2][-1, :, 1] + 0.25
    slip = driven.poses[:, -1, 1] + 0.25
    assert (np.abs(slip - wanted) <= np.maximum(0.003, 0.1 * wanted)).all()


def test_a_grazing_robot_turns_as_the_oracle(grazing, driven):
    difference = driven.poses[:, -1, 2] - grazing[2][-1, :, 2]
    assert np.degrees(np.abs(difference)).max() <= 2


def test_the_wheels_of_a_grazing_robot_carry_what_statics_says(grazing, planar, driven):
    wanted = grazing[3][STEPS // 2 :].mean(axis=0)
    np.testing.assert_allclose(driven.loads[:, :2], wanted, rtol=0.15)
    weight = planar.mass * GRAVITY
    np.testing.assert_allclose(driven.loads.sum(axis=1), weight, rtol=0.03)


def test_the_loads_at_rest_are_those_of_the_page(planar):
    loads = Driven(np.zeros((1, 2)), np.zeros((1, 3)), None).loads[0]
    weight = planar.mass * GRAVITY
    np.testing.assert_allclose(loads[:2], (weight - HELD) / 2, rtol=0.02)
    np.testing.assert_allclose(loads[2:], HELD / 2, rtol=0.1)


@pytest.mark.parametrize(
    ("motors", "start"),
    [
        ((-0.5, 0.5), (0, 0, 0)),
        ((0.5, 0.3), (0, 0, 0)),
        ((0.5, 0.5), (-0.4, 0.1, 0.3)),
        ((-0.5, -0.2), (0, 0, 1)),
        ((0.5, 0.5), (0.45, 0.3, 0.7)),  # into a corner
        ((0.5, 0.45), (0.3, 0.0, 0.2)),  # drives against a wall
    ],
    ids=["spin", "arc", "straight", "arc backwards", "corner", "arrival"],
)
def test_a_robot_drives_as_the_oracle(planar, size, motors, start):
    half = size.half_length, size.half_width
    wanted, _ = drive(planar, [motors], [start], STEPS / 10, half)
    poses = Driven([motors], np.array([start]), None).poses[0]
    travel = np.hypot(*(poses[:, :2] - wanted[:, 0, :2]).T).max()
    turn = np.unwrap(poses[:, 2]) - wanted[:, 0, 2]
    print(travel, np.degrees(np.abs(turn).max()))
    assert travel < 0.004
    assert np.degrees(np.abs(turn)).max() < 4
