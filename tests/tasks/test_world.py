"""Worlds: what reaches motors and brain, in each simulator."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from strategies import worlds

from musebot.models import Dimensions, Kinematics, arena_spec
from musebot.tasks import make_batch, make_kinematic_batch
from musebot.tasks.suite import TASKS
from musebot.tasks.world import SENSORS, World

REVERSED = World(wheels=(-1.0, 0.0, 0.0, 1.0))
shares = st.floats(-1, 1)
MAKERS = {
    "mujoco": make_batch,
    "kinematic": lambda task, robots: make_kinematic_batch(task, robots, Kinematics()),
}
SIZE = Dimensions.of(arena_spec().compile())


@pytest.fixture(params=MAKERS)
def make(request):
    return MAKERS[request.param]


def readings(make, x, y, heading, task="spot_or_driving"):
    """Returns robots at a pose, with the spot in the middle; and their rules outside any world."""
    batch = make(task, 1)
    batch.place_spot(np.array([0]), np.zeros((1, 2)))
    batch.place(np.array([0]), np.array([[x, y, heading]]))
    return batch, batch.rules


# Motors


def test_the_default_world_changes_nothing(make):
    batch, rules = readings(make, 0.1, 0.05, 0.3)
    motors = np.array([[0.7, -0.2]])
    batch.enter(World())
    assert batch.rules is rules and World().motors(motors) is motors
    unchanged = World(sensors=tuple((name, 0.0, 1.0) for name in SENSORS))
    ours, theirs = (found.observations(batch.sensordata) for found in (
        unchanged.rules(rules, SIZE.nose), rules))  # fmt: skip
    np.testing.assert_equal(ours, theirs)


@given(worlds, st.lists(st.tuples(shares, shares), min_size=1, max_size=3))
def test_the_wheels_receive_a_clipped_linear_map_of_the_clipped_motors(world, motors):
    found = world.motors(np.array(motors))
    clipped = np.clip(motors, -0.5, 0.5)
    wanted = np.clip(clipped @ np.reshape(world.wheels, (2, 2)).T, -0.5, 0.5)
    np.testing.assert_allclose(found, wanted, atol=1e-15)
    np.testing.assert_array_equal(found[-1], world.motors(np.array(motors[-1])))  # one robot


def test_a_reversed_wheel_drives_as_the_inverse_motors_do(make):
    first, second = make("spot_finding_walls", 3), make("spot_finding_walls", 3)
    first.enter(REVERSED)
    random = np.random.default_rng(0)
    for _ in range(50):
        motors = random.uniform(-0.7, 0.7, (3, 2))
        first.step(motors)
        second.step(np.clip(motors, -0.5, 0.5) * [-1, 1])
    np.testing.assert_equal(first.arrays(), second.arrays())
    assert np.abs(first.pose).min() > 0


# Senses


@given(st.floats(-0.4, 0.4), st.floats(-0.25, 0.25), st.floats(-3, 3))
def test_a_nose_behind_smells_what_the_nose_of_a_robot_that_looks_back_smells(x, y, heading):
    make = MAKERS["kinematic"]
    batch, rules = readings(make, x, y, heading)
    back, _ = readings(make, x, y, heading + np.pi)
    for angle, other in ((180.0, back), (-180.0, back), (360.0, batch)):
        turned = World(nose=angle).rules(rules, batch.dimensions.nose)
        ours, theirs = turned.observations(batch.sensordata), rules.observations(other.sensordata)
        np.testing.assert_allclose(ours["nose"], theirs["nose"], atol=1e-12)
        np.testing.assert_array_equal(
            ours["distances"], rules.observations(batch.sensordata)["distances"]
        )
        inside = np.hypot(*other.sensordata[0, rules.layout.smell][:2])
        if abs(inside - batch.dimensions.spot_radius) > 1e-9:
            assert turned.event(batch.sensordata) == rules.event(other.sensordata)


@given(worlds, st.floats(-0.4, 0.4), st.floats(-0.25, 0.25), st.floats(-3, 3))
def test_a_wrong_sensor_reads_offset_and_gain_of_its_signal_within_its_range(world, x, y, heading):
    batch, rules = readings(MAKERS["kinematic"], x, y, heading)
    right = World(nose=world.nose).rules(rules, batch.dimensions.nose)
    signals = right.state(batch.sensordata)[0]
    found = world.rules(rules, batch.dimensions.nose).state(batch.sensordata)[0]
    wrong = {name: (offset, gain) for name, offset, gain in world.sensors}
    low, high = rules.bounds()
    for number, name in enumerate(SENSORS):
        offset, gain = wrong.get(name, (0.0, 1.0))
        wanted = np.clip(offset + gain * signals[number], low[number], high[number])
        assert found[number] == (wanted if name in wrong else signals[number])


def test_driving_is_rewarded_alike_in_both_simulators_and_as_its_task_rewards_it():
    world, shares = World(rewarded="driving"), []
    for make in MAKERS.values():
        batch, rules = readings(make, -0.3, 0.0, 0.0)
        batch.enter(world)
        rewards, events = [], []
        for speed, steps in ((0.5, 20), (0.3, 10), (0.2, 10), (-0.5, 10), (0.5, 40)):  # into a wall
            for _ in range(steps):
                batch.step(np.full((1, 2), speed))
            rewards.append(batch.rules.checked_reward(batch.sensordata)[0])
            events.append(batch.rules.event(batch.sensordata)[0])
            np.testing.assert_array_equal(
                batch.rules.reward(batch.sensordata), rules.driving.reward(batch.sensordata)
            )
        assert events == [True, True, False, False, False]
        shares.append(rewards)
    np.testing.assert_allclose(*shares, atol=0.02)
    np.testing.assert_allclose(shares[0], [1, 0.6, 0.4, 0, 0], atol=0.03)


@pytest.mark.parametrize(
    ("task", "world", "sentence"),
    [
        ("wall_avoidance", World(nose=90), "has no single nose"),
        ("spot_finding_two_noses", World(nose=90), "has no single nose"),
        ("spot_finding", World(sensors=(("left", 0, 0),)), "sensors of this task are nose, got"),
        ("spot_finding_two_noses", World(sensors=(("nose", 0, 0),)), "are none that can be wrong"),
        ("spot_finding_walls", World(rewarded="driving"), "only the task spot_or_driving can"),
    ],
)
def test_a_world_of_what_the_robot_does_not_sense_is_refused(task, world, sentence):
    batch = make_batch(task, 1)
    with pytest.raises(ValueError, match=sentence) as caught:
        batch.enter(world)
    assert "\n" not in str(caught.value) and batch.world == World()
    assert type(batch.rules) is TASKS[task].rules


def test_distances_that_are_not_the_four_of_our_robot_cannot_be_wrong():
    rules = make_batch("wall_avoidance", 1).rules
    three = type("Three", (type(rules),), {"shapes": {"distances": (3, 0, 1)}})(rules.layout)
    with pytest.raises(ValueError, match="are none that can be wrong, got 'front'"):
        World(sensors=(("front", 0, np.float64(0)),)).rules(three, 0.0)


def test_lists_as_files_have_them_make_a_world():
    lists = World(wheels=[-1.0, 0, 0, 1], sensors=[["nose", 0, 1]])
    assert lists == World(REVERSED.wheels, sensors=(("nose", 0, 1),))


@pytest.mark.parametrize(
    ("fields", "sentence"),
    [
        ({"wheels": (1.0, 0.0)}, r"wheels must be 4 numbers, got \(1.0, 0.0\)"),
        ({"wheels": (2.0, 0.0, 0.0, 1.0)}, "wheels must be .* a number in"),
        ({"nose": 361}, "nose must be a number in .* degrees, got 361"),
        ({"sensors": (("ear", 0, 1),)}, "sensors must be a list of .*got"),
        ({"sensors": (("nose", 0, True),)}, "sensors must be a list of .*got"),
        ({"sensors": (("nose", 0, 2),)}, "sensors must be .* from -1 to 1, got"),
        ({"sensors": [["nose", 0]]}, "sensors must be a list of .*got"),
        ({"sensors": (("nose", 0, 1),) * 2}, "with different names of nose, front"),
    ],
)
def test_what_is_no_world_is_refused_with_one_sentence(fields, sentence):
    with pytest.raises(ValueError, match=sentence) as caught:
        World(**fields)
    assert "\n" not in str(caught.value)
