"""What edits add: obstacles, a speed, two noses, walls that spoil a smell, jumps, room."""

import dataclasses
import functools

import mujoco
import numpy as np
import pytest

import musebot
from musebot.models import (
    Dimensions,
    add_noses,
    add_obstacles,
    add_velocity,
    arena_spec,
    enlarge,
    hide_spot,
)
from musebot.tasks import make_batch
from musebot.tasks.arena import random_poses
from musebot.tasks.suite import TASKS


def drive(task, motors, steps=1, **kwargs):
    environment = musebot.load("arena", task, task_kwargs={"random": 0, **kwargs})
    environment.reset()
    timesteps = [environment.step(np.asarray(motors)) for _ in range(steps)]
    return environment, timesteps


def observed(timesteps, name):
    return np.array([timestep.observation[name] for timestep in timesteps])


def test_tasks_without_additions_have_the_papers_arena():
    for name, row in TASKS.items():
        spec = arena_spec()
        if name.startswith("wall"):
            hide_spot(spec)
        added = {add_noses, add_obstacles, add_velocity} & set(row.edits)
        assert (row.spec().to_xml() == spec.to_xml()) == (not added)


def test_unit_wall_avoidance_pays_one_and_nothing_in_contact():
    _, timesteps = drive("wall_avoidance_unit", [1.0, 1.0], 40, robot=(0.3, 0.0, 0.0))
    rewards = np.array([timestep.reward for timestep in timesteps])
    contact = observed(timesteps, "contact")[:, 0]
    assert set(rewards) == {0.0, 1.0}
    np.testing.assert_array_equal(rewards, 1 + contact)


def obstacles():
    return make_batch("wall_avoidance_obstacles", 1).dimensions.obstacles


@pytest.mark.parametrize("x, y, radius", obstacles())
def test_a_robot_sees_and_feels_an_obstacle_and_cannot_pass(x, y, radius):
    start = (x - radius - 0.07, y, 0.0)
    environment, timesteps = drive("wall_avoidance_obstacles", [1.0, 1.0], 20, robot=start)
    distance = 0.07 - 0.0275
    first = musebot.load("arena", "wall_avoidance_obstacles", {"robot": start}).reset()
    signal = first.observation["distances"][0]
    assert signal == pytest.approx((1 + distance) ** -10, rel=1e-6)
    assert (observed(timesteps, "contact")[8:] == -1).all()
    assert (observed(timesteps, "distances")[8:, 0] > 0.97).all()  # at its surface, never inside
    rim = np.hypot(*(environment.physics.robot_pose()[:2] - [x, y])) - 0.0275
    assert rim == pytest.approx(radius, abs=0.001)


def test_random_starts_are_clear_of_obstacles_and_cover_the_rest():
    size = make_batch("wall_avoidance_obstacles", 1).dimensions
    poses = random_poses(np.random.default_rng(0), size, 2000)
    for x, y, radius in size.obstacles:
        apart = np.hypot(poses[:, 0] - x, poses[:, 1] - y)
        assert apart.min() >= radius + size.radius + 0.01
        assert apart.min() < radius + size.radius + 0.03


def test_driving_is_paid_by_speed_ahead_and_standing_still_is_not():
    def reward(motors):
        _, timesteps = drive("wall_avoidance_obstacles", motors, 10, robot=(0.0, 0.25, 0.0))
        return timesteps[-1].reward, timesteps[-1].observation["speed"][0]

    assert reward([1.0, 1.0]) == pytest.approx((1, 1), abs=0.01)
    assert reward([0.5, 0.5]) == pytest.approx((0.5, 0.5), abs=0.01)
    assert reward([0.0, 0.0]) == pytest.approx((0, 0), abs=1e-6)
    assert reward([-1.0, -1.0]) == pytest.approx((0, -1), abs=0.01)
    assert reward([-1.0, 1.0]) == pytest.approx((0, 0), abs=0.01)


def test_no_obstacle_is_paid_for_pushing():
    x, y, radius = obstacles()[0]
    _, timesteps = drive(
        "wall_avoidance_obstacles", [1.0, 1.0], 30, robot=(x - radius - 0.04, y, 0.0)
    )
    assert timesteps[-1].reward == 0


@pytest.mark.parametrize("side, stronger", [(1, 0), (-1, 1)])
def test_the_nose_nearer_to_the_spot_smells_more(side, stronger):
    first = musebot.load(
        "arena",
        "spot_finding_two_noses",
        {"robot": (0.0, 0.0, 0.0), "spot": (0.25, side * 0.04)},
    ).reset()
    noses = first.observation["noses"]
    assert noses[stronger] > 1.2 * noses[1 - stronger] > 0


def test_two_noses_smell_alike_straight_ahead_and_everything_inside():
    ahead = {"robot": (0.0, 0.0, 0.0), "spot": (0.25, 0.0)}
    noses = musebot.load("arena", "spot_finding_two_noses", ahead).reset().observation["noses"]
    assert noses[0] == pytest.approx(noses[1], abs=1e-12) and noses[0] > 0
    inside = {"robot": (0.0, 0.0, 0.0), "spot": (0.02, 0.0)}
    _, timesteps = drive("spot_finding_two_noses", [0.0, 0.0], **inside)
    assert timesteps[-1].reward == pytest.approx(10 / 11)


def test_a_robot_against_a_wall_smells_for_nothing():
    kwargs = {"robot": (0.45, 0.0, 0.0), "spot": (0.49, 0.0)}
    _, timesteps = drive("spot_finding_walls", [1.0, 1.0], 10, **kwargs)
    assert timesteps[0].reward > 0.9 and timesteps[-1].reward == 0
    assert timesteps[-1].observation["nose"][0] > 0.9  # it still smells it
    assert timesteps[-1].observation["contact"][0] == -1


def test_the_spot_jumps_every_twenty_seconds_and_stays_in_between():
    environment = musebot.load("arena", "spot_finding_jumping", task_kwargs={"random": 0})
    for _ in range(2):  # episodes
        environment.reset()
        spots = []
        for _ in range(1000):
            environment.step(np.zeros(2))
            spots.append(tuple(environment.physics.spot_position()))
        changes = [k for k in range(1, 1000) if spots[k] != spots[k - 1]]
        assert changes == [200, 400, 600, 800]  # the first action of the 21st second, and so on
        assert len(set(spots)) == 5


def test_obstacles_are_fixed_and_named_and_keep_off_the_wheels():
    model = TASKS["wall_avoidance_obstacles"].spec().compile()
    for number in (1, 2, 3):
        assert model.body(f"obstacle_{number}").dofnum[0] == 0
        core = model.geom(f"obstacle_{number}_core")
        wheel = model.geom("left_wheel")
        assert not (core.contype[0] & wheel.conaffinity[0]) | (
            wheel.contype[0] & core.conaffinity[0]
        )
    assert mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_SENSOR, "velocity") >= 0


# ---- A larger arena ----


@pytest.mark.parametrize("task", ["wall_avoidance", "wall_avoidance_obstacles"])
def test_an_arena_that_is_enlarged_is_larger_and_nothing_else(task):
    small, large = (
        Dimensions.of(TASKS[task].spec(edits=edits).compile())
        for edits in ((), (functools.partial(enlarge, factor=4 / 3),))
    )
    assert large.half_length == pytest.approx(0.70)
    assert large.half_width == pytest.approx(0.35 * 4 / 3)
    same = {"half_length": small.half_length, "half_width": small.half_width}
    assert dataclasses.replace(large, **same) == small


def enlarged(factor, task="wall_avoidance"):
    return make_batch(task, 8, edits=(functools.partial(enlarge, factor=factor),))


def test_its_walls_are_seen_where_they_are():
    batch = enlarged(2.0)
    size, layout = batch.dimensions, batch.rules.layout
    for heading, walls in ((0.0, "xXYy"), (np.pi / 2, "YyXx")):
        batch.place(np.arange(8), np.tile([0.3, 0.2, heading], (8, 1)))
        away = {
            "x": size.half_length - 0.3,
            "X": size.half_length + 0.3,
            "y": size.half_width + 0.2,
            "Y": size.half_width - 0.2,
        }
        expected = [away[wall] - size.radius for wall in walls]
        np.testing.assert_allclose(batch.sensordata[0, layout.distances], expected, atol=1e-6)
    backs = mujoco.mj_name2id(batch.model, mujoco.mjtObj.mjOBJ_GEOM, "east_back")
    assert batch.model.geom_pos[backs, 0] == pytest.approx(size.half_length + 0.001)


def test_no_robot_leaves_it_and_each_gets_where_the_small_one_ends():
    batch = enlarged(4 / 3)
    size = batch.dimensions
    angles = np.arange(8) * np.pi / 4
    batch.place(np.arange(8), np.stack([0 * angles, 0 * angles, angles], axis=1))
    for _ in range(100):
        batch.step(np.full((8, 2), 0.5))
    assert batch.valid.all()
    reached = np.abs(batch.pose[:, :2])
    room = np.array([size.half_length, size.half_width]) - size.radius
    assert (reached < room + 1e-3).all()
    assert (np.abs(reached - room) < 2e-3).any(axis=1).all()
    assert batch.rules.event(batch.sensordata).all()


def test_what_is_drawn_of_it_stands_where_its_walls_do():
    spec = arena_spec()
    enlarge(spec, 2.0)
    model = spec.compile()
    for name, axis in (("east", 0), ("west", 0), ("north", 1), ("south", 1)):
        wall, drawn = model.geom(name).pos[axis], model.site(name)
        assert abs(drawn.pos[axis]) - drawn.size[axis] == pytest.approx(abs(wall))
        across = model.geom("north" if axis == 0 else "east").pos[1 - axis]
        assert drawn.size[1 - axis] >= across
    assert model.geom("floor").size[0] > 1.05 and model.geom("floor").size[1] > 0.70


@pytest.mark.parametrize("factor", [0.9, 0.0, -1.0, float("nan"), float("inf")])
def test_an_arena_is_not_made_smaller(factor):
    spec = arena_spec()
    before = spec.to_xml()
    with pytest.raises(ValueError, match="factor must be finite and at least 1, got"):
        enlarge(spec, factor)
    assert spec.to_xml() == before
