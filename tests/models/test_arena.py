"""The body drives as commanded, rests where it stands, and touches walls only."""

import mujoco
import numpy as np
import pytest
from dm_control import mjcf
from mujoco import rollout

from musebot.models import (
    ARENA_XML,
    ROBOT_XML,
    Dimensions,
    add_obstacles,
    arena_spec,
    check_versions,
    robot_pose,
    robot_qpos,
)

STATE = mujoco.mjtState.mjSTATE_FULLPHYSICS.value


class Motion:
    """Motion of B robots from the same start, with motor values of shape (B, T, 2).

    Attributes:
      poses: x, y in [m] and heading in [rad] at the end of every control step, shape (B, T, 3).
      gap: Distance in [m] from rim to wall at the last sensor reading of a step, shape (B, T).
      touch: Force in [N] at that reading, shape (B, T).
      deepest: Smallest distance in [m] from rim to wall, over all substeps.
      tilt: Largest tilt in degrees, over all substeps.
    """

    def __init__(self, motors, start, substeps=None):
        spec = arena_spec()
        spec.option.timestep = 0.1 / substeps if substeps else spec.option.timestep
        model = spec.compile()
        data, size = mujoco.MjData(model), Dimensions.of(model)
        data.qpos[:] = robot_qpos(np.array(start))
        first = np.empty(mujoco.mj_stateSize(model, STATE))
        mujoco.mj_getState(model, data, first, STATE)
        substeps = round(0.1 / model.opt.timestep)
        control = np.repeat(np.asarray(motors, float), substeps, axis=1)
        states, sensors = rollout.rollout(model, data, np.tile(first, (len(motors), 1)), control)
        x, y, i, j = (np.abs(states[..., k]) for k in (1, 2, 5, 6))
        gap = np.minimum(size.half_length - x, size.half_width - y) - size.radius
        self.poses = robot_pose(states[:, substeps - 1 :: substeps, 1:])
        self.gap = gap[:, substeps - 2 :: substeps]  # sensors show the start of the last substep
        self.touch = sensors[:, substeps - 1 :: substeps, model.sensor("touch").adr[0]]
        self.deepest, self.tilt = gap.min(), np.degrees(np.arccos(1 - 2 * (i * i + j * j))).max()


def random_motors(robots, steps, seed=0):
    """Full speed ahead or back of each wheel, held for 1 to 20 control steps, shape (B, T, 2)."""
    random, motors = np.random.default_rng(seed), []
    for _ in range(robots):
        holds = random.integers(1, 21, steps)
        motors.append(np.repeat(random.choice([-0.5, 0.5], (steps, 2)), holds, axis=0)[:steps])
    return np.stack(motors)


@pytest.fixture(scope="module")
def model():
    return arena_spec().compile()


@pytest.fixture(scope="module")
def size(model):
    return Dimensions.of(model)


def test_dimensions_are_those_of_the_paper_and_a_khepera(model, size):
    assert (size.half_length, size.half_width) == (0.525, 0.35)
    assert size.radius == 0.0275
    assert size.spot_radius == 0.06
    assert size.motor_speed == pytest.approx(0.2)
    assert model.body("robot").subtreemass[0] == pytest.approx(0.080)


def test_wheels_stay_within_the_outline(model, size):
    half_width, radius = model.geom("left_wheel").size[1], model.geom("left_wheel").size[0]
    corner = np.hypot(radius, size.wheel_base / 2 + half_width)
    assert corner < size.radius
    assert corner > size.radius - 0.001  # as far apart as possible


def test_obstacles_do_not_touch_the_wheels():
    spec = arena_spec()
    add_obstacles(spec)
    model = spec.compile()
    wheel = model.geom("left_wheel")
    for number in (1, 2, 3):
        core = model.geom(f"obstacle_{number}_core")
        assert not core.contype[0] & wheel.conaffinity[0]
        assert not wheel.contype[0] & core.conaffinity[0]


def test_straight_speed_is_within_one_percent_of_the_commanded(size):
    motors = np.array([0.5, 0.25])
    poses = Motion(np.tile(motors[:, None, None], (1, 20, 2)), (-0.45, 0, 0)).poses
    speed = poses[:, -1, 0] - poses[:, 9, 0]  # [m] in the second second
    np.testing.assert_allclose(speed, 2 * motors * size.motor_speed, rtol=0.01)


def test_spinning_speed_is_within_two_percent_of_the_commanded(size):
    headings = Motion(np.tile([-0.5, 0.5], (1, 40, 1)), (0, 0, 0)).poses[0, :, 2]
    rate = np.diff(np.unwrap(headings))[20:].mean() / 0.1
    assert rate == pytest.approx(2 * size.motor_speed / size.wheel_base, rel=0.02)


def test_in_ten_minutes_a_spin_drifts_less_than_a_millimetre_and_nothing_moves_at_rest():
    motors = np.tile(np.array([[-0.5, 0.5], [0, 0]])[:, None], (1, 6000, 1))
    poses = Motion(motors, (0, 0, 0)).poses
    assert (np.hypot(poses[..., 0], poses[..., 1]).max(axis=1) < [1e-3, 1e-6]).all()


def test_driving_into_walls_for_five_minutes_neither_tilts_nor_penetrates_them(size):
    crash = Motion(random_motors(4, 3000), (-0.425, 0.25, 3 * np.pi / 4))
    assert crash.tilt < 5 and crash.deepest > -0.001
    assert np.abs(crash.poses[..., 0]).max() < size.half_length
    assert np.abs(crash.poses[..., 1]).max() < size.half_width
    # Contact equals geometry in 99 % of the steps.
    touching, near = crash.touch > 0, crash.gap <= size.contact_margin
    assert size.contact_margin == 0.0005
    assert near.mean() > 0.02  # there are contacts
    assert (touching == near).mean() >= 0.99


@pytest.mark.parametrize("forwards", [True, False])
def test_a_robot_that_pushes_a_wall_is_in_contact_in_every_step(forwards):
    motors = np.tile(np.array([0.5, 0.1])[:, None, None], (1, 600, 2))
    start = (0.525 - 0.0275 - 0.0002, 0.0, 0.0 if forwards else np.pi)
    assert (Motion(motors if forwards else -motors, start).touch > 0).all()


def test_a_robot_pressed_against_a_wall_is_free_to_turn(size):
    motors = np.array([(0.5, 0.3), (0.5, 0.1), (0.3, 0.1), (0.2, 0.1), (0.5, -0.1)])
    headings = Motion(np.tile(motors[:, None], (1, 50, 1)), (0.4970, 0, 0)).poses[..., 2]
    turned = np.abs(np.unwrap(headings, axis=1)[:, -1])
    commanded = (motors[:, 0] - motors[:, 1]) * 2 * size.motor_speed / size.wheel_base * 5
    assert (turned > 0.8 * commanded).all()


@pytest.mark.parametrize("degrees", [0, 15, 30, 45])
def test_a_robot_pressed_against_a_wall_turns_as_commanded(degrees, size):
    motors = np.array([(0.5, 0.5), (0.45, 0.43), (0.43, 0.45)])
    start = (0.525 - 0.0275 - 0.001, 0, np.radians(degrees))
    headings = Motion(np.tile(motors[:, None], (1, 10, 1)), start).poses[:, -1, 2]
    commanded = (motors[:, 1] - motors[:, 0]) * 2 * size.motor_speed / size.wheel_base
    np.testing.assert_allclose(headings - start[2], commanded, atol=0.05)


def test_touch_ignores_floor_wheels_and_castors():
    touch = Motion(random_motors(5, 20), (0, 0, 0)).touch
    assert (touch == 0).all()


def test_touch_senses_a_wall_on_every_side(model):
    data = mujoco.MjData(model)
    for degrees in range(0, 360, 15):
        data.qpos[:] = robot_qpos(np.array([0.525 - 0.0275 + 0.0001, 0, np.radians(degrees)]))
        mujoco.mj_forward(model, data)
        assert data.sensor("touch").data[0] > 0, degrees


def wall_distance(x, y, direction):
    """Returns the distance from a point in the arena to the walls along a direction."""
    dx, dy = np.cos(direction), np.sin(direction)
    along_x = (np.copysign(0.525, dx) - x) / dx if abs(dx) > 1e-12 else np.inf
    along_y = (np.copysign(0.35, dy) - y) / dy if abs(dy) > 1e-12 else np.inf
    return min(along_x, along_y)


def test_rangefinders_read_the_analytic_distance_over_1000_poses(model, size):
    random = np.random.default_rng(0)
    data = mujoco.MjData(model)
    offsets = {"front": 0, "back": np.pi, "left": np.pi / 2, "right": -np.pi / 2}
    worst = 0.0
    for _ in range(1000):
        x, y = random.uniform(-1, 1, 2) * [0.525 - size.radius, 0.35 - size.radius]
        heading = random.uniform(-np.pi, np.pi)
        data.qpos[:7] = x, y, 0, np.cos(heading / 2), 0, 0, np.sin(heading / 2)
        mujoco.mj_forward(model, data)
        for name, offset in offsets.items():
            expected = wall_distance(x, y, heading + offset) - size.radius
            worst = max(worst, abs(data.sensor(name).data[0] - expected))
    assert worst < 0.0005


def test_a_rangefinder_inside_a_wall_still_sees_it(model, size):
    data = mujoco.MjData(model)
    for name, heading in (("front", 0), ("back", np.pi), ("left", -np.pi / 2)):
        for gap in (0.0, -0.0002, -0.0008):
            place = size.half_length - size.radius - gap
            data.qpos[:] = robot_qpos(np.array([place, 0, heading]))
            mujoco.mj_forward(model, data)
            assert 0 <= data.sensor(name).data[0] <= 0.001 + 1e-9, (name, gap)


def test_the_spot_has_no_contacts_and_moves_without_recompiling(model):
    data = mujoco.MjData(model)
    data.mocap_pos[0, :2] = 0, 0
    mujoco.mj_step(model, data, 10)
    assert data.sensor("touch").data[0] == 0
    assert model.body("spot").geomnum[0] == 0
    assert data.site("spot").xpos[:2] == pytest.approx([0, 0])


def test_the_robot_attaches_to_another_arena_and_senses_its_walls():
    spec = mujoco.MjSpec.from_string("""
        <mujoco><option timestep="0.005" integrator="implicitfast"/><worldbody>
          <geom type="plane" size="1 1 .1"/><geom type="box" pos=".3 0 .05" size=".02 1 .05"/>
          <frame name="here" pos="0.1 0 0"/>
        </worldbody></mujoco>""")
    robot = mujoco.MjSpec.from_file(str(ROBOT_XML))
    spec.attach(robot, frame=spec.frame("here"), prefix="a_")
    model = spec.compile()
    data = mujoco.MjData(model)
    data.ctrl[:] = 0.5
    mujoco.mj_step(model, data, 100)
    mujoco.mj_forward(model, data)  # after a step the sensors show its start
    assert data.sensor("a_touch").data[0] == 0
    assert data.sensor("a_front").data[0] == pytest.approx(0.28 - data.qpos[0] - 0.0275, abs=5e-4)
    mujoco.mj_step(model, data, 300)
    assert data.sensor("a_touch").data[0] > 0
    assert data.qpos[0] == pytest.approx(0.28 - 0.0275, abs=0.001)


def test_pymjcf_compiles_the_same_arena(model):
    ours = mujoco.MjData(model)
    theirs = mjcf.Physics.from_mjcf_model(mjcf.from_path(str(ARENA_XML)))
    for data in (ours, theirs.data.ptr):
        data.qpos[:3] = 0.45, 0.1, 0
        data.ctrl[:] = 0.5, 0.4
    mujoco.mj_step(model, ours, 140)
    mujoco.mj_step(theirs.model.ptr, theirs.data.ptr, 140)
    np.testing.assert_allclose(theirs.data.qpos, ours.qpos, rtol=0, atol=1e-9)
    for name in ("front", "touch", "smell"):  # PyMJCF arranges the sensors in another order
        measured, ours_of_it = theirs.named.data.sensordata[name], ours.sensor(name).data
        np.testing.assert_allclose(measured, ours_of_it, rtol=1e-6, atol=1e-9)
    assert ours.sensor("touch").data[0] > 0


def test_pymjcf_attaches_the_robot_without_its_joint():
    world = mjcf.RootElement(model="world")
    world.option.integrator, world.option.timestep = "implicitfast", 0.005
    world.worldbody.add("geom", type="plane", size=[1, 1, 0.1])
    robot = mjcf.from_path(str(ROBOT_XML))
    robot.find("joint", "robot").remove()
    world.attach(robot).add("freejoint")
    physics = mjcf.Physics.from_mjcf_model(world)
    physics.bind(robot.find_all("actuator")).ctrl = 0.5
    physics.step(200)
    assert 0.15 < physics.bind(robot.find("body", "robot")).xpos[0] < 0.2  # a second at 0.2 m/s


def test_half_the_motor_speed_is_half_the_speed_with_the_same_torque():
    slow, ours = arena_spec(motor_speed=0.1).compile(), arena_spec().compile()
    assert Dimensions.of(slow).motor_speed == pytest.approx(0.1)

    def stall(model):
        return 0.5 * model.actuator_gainprm[0, 0] * model.actuator_gear[0, 0]

    assert stall(slow) == pytest.approx(stall(ours))


def test_the_speed_of_wheels_whose_joints_have_other_names_can_be_set(tmp_path):
    text = ROBOT_XML.read_text()
    for side in ("left", "right"):
        for before in (f'joint="{side}_wheel"', f'joint name="{side}_wheel"'):
            assert before in text
            text = text.replace(before, before.replace("wheel", "axle"))
    (tmp_path / "robot.xml").write_text(text)
    arena = ARENA_XML.read_text().replace(ROBOT_XML.name, str(tmp_path / "robot.xml"))
    (tmp_path / "arena.xml").write_text(arena)
    slow = arena_spec(tmp_path / "arena.xml", motor_speed=0.1).compile()
    assert Dimensions.of(slow).motor_speed == pytest.approx(0.1)


def test_an_unsupported_mujoco_is_refused_with_the_supported_one(monkeypatch):
    monkeypatch.setattr(mujoco, "__version__", "4.0.0")
    with pytest.raises(ImportError, match=r"musebot needs MuJoCo 3\.17\.x.*got 4\.0\.0"):
        check_versions()
