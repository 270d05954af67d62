"""The batch of robots and the dm_control environment are bit-exact."""

import dataclasses
import warnings

import numpy as np
import pytest

from musebot.models import robot_pose, robot_qpos
from musebot.tasks import ALL_TASKS, load, make_batch
from musebot.tasks.starts import Start

TASKS = [task for _, task in ALL_TASKS]


def scripted_motors(steps, seed=0):
    random = np.random.default_rng(seed)
    motors = random.uniform(-0.6, 0.6, (steps, 2))  # some are beyond the limits
    for start in range(0, steps, 40):  # and long straight drives into walls
        if random.random() < 0.5:
            motors[start : start + 30] = random.choice([-0.5, 0.5])
    return motors


@pytest.mark.parametrize("task", TASKS)
def test_the_batch_equals_the_environment_bit_exactly(task):
    start, second, spot = (-0.425, 0.25, 2.356), (0.3, -0.2, 0.4), (0.1, 0.05)
    environment = load("arena", task, {"robot": start, "spot": spot, "time_limit": 1e9})
    environment.task.spot_steps = 0  # the caller of a batch moves the spot
    batch = make_batch(task, 3)
    everyone = np.arange(3)
    timestep = environment.reset()
    batch.place_spot(everyone, np.tile(spot, (3, 1)))
    batch.place(everyone, np.tile(start, (3, 1)))
    touched = 0
    for step, motor in enumerate(scripted_motors(3000)):
        if step in (700, 1500):
            environment.task.start = Start(second, spot)
            timestep = environment.reset()
            batch.place(everyone, np.tile(second, (3, 1)))
        if step == 2200:
            environment.physics.place_spot(-0.2, 0.1)
            batch.place_spot(everyone, np.tile([-0.2, 0.1], (3, 1)))
        np.testing.assert_array_equal(
            np.concatenate(list(timestep.observation.values())),
            batch.rules.state(batch.sensordata)[1],
        )
        timestep = environment.step(motor / 0.5 * environment.task.limit)
        others = np.random.default_rng(step).uniform(-0.5, 0.5, (2, 2))
        batch.step(np.stack([others[0], motor, others[1]]))
        qpos = batch.arrays()["state"][1, 1:10]
        np.testing.assert_array_equal(environment.physics.data.qpos, qpos)
        np.testing.assert_array_equal(environment.physics.data.sensordata, batch.sensordata[1])
        np.testing.assert_array_equal(environment.physics.robot_pose(), batch.pose[1])
        assert timestep.reward == batch.rules.reward(batch.sensordata)[1]
        touched += bool(batch.sensordata[1, batch.rules.layout.touch][0] > 0)
    assert touched > 100
    assert batch.valid.all()


@pytest.mark.parametrize("task", TASKS)
def test_the_number_of_threads_changes_no_result(task):
    batches = [make_batch(task, 7, threads=threads) for threads in (0, 1, 2, 3)]
    motors = np.random.default_rng(0).uniform(-0.5, 0.5, (200, 7, 2))
    for motor in motors:
        for batch in batches:
            batch.step(motor)
    for batch in batches[1:]:
        for name, array in batch.arrays().items():
            np.testing.assert_array_equal(array, batches[0].arrays()[name])


def test_robots_do_not_affect_one_another():
    alone, together = make_batch("wall_avoidance", 1), make_batch("wall_avoidance", 4)
    for motor in scripted_motors(200):
        alone.step(motor[None])
        together.step(np.stack([motor, -motor, motor / 2, motor]))
    np.testing.assert_array_equal(alone.sensordata[0], together.sensordata[0])
    np.testing.assert_array_equal(together.sensordata[0], together.sensordata[3])


def test_a_restored_batch_continues_bit_exactly():
    first, second = make_batch("spot_finding", 5), make_batch("spot_finding", 5)
    motors = np.random.default_rng(0).uniform(-0.5, 0.5, (100, 5, 2))
    first.place_spot(np.arange(5), np.full((5, 2), 0.1))
    for motor in motors[:50]:
        first.step(motor)
    second.load_arrays({name: array.copy() for name, array in first.arrays().items()})
    for motor in motors[50:]:
        first.step(motor)
        second.step(motor)
    for name, array in first.arrays().items():
        np.testing.assert_array_equal(array, second.arrays()[name])


@pytest.mark.parametrize("how", ["motor", "velocity", "escape"])
def test_an_unstable_robot_is_stopped_and_the_others_continue(how, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)  # MuJoCo writes its log into the working directory
    batch, twin = make_batch("wall_avoidance", 3), make_batch("wall_avoidance", 3)
    motors = np.full((3, 2), [0.3, 0.1])
    bad = motors.copy()
    if how == "motor":
        bad[1] = np.nan
    elif how == "velocity":
        batch.arrays()["state"][1, 10:] = np.inf
    else:  # no robot passes these walls: reduce the length instead
        batch.place(np.array([1]), np.array([[0.4, 0.0, 0.0]]))
        batch.dimensions = dataclasses.replace(batch.dimensions, half_length=0.39)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        batch.step(bad)
    twin.step(motors)
    for _ in range(20):
        batch.step(motors)
        twin.step(motors)
    assert batch.valid.tolist() == [True, False, True]
    np.testing.assert_array_equal(batch.sensordata[[0, 2]], twin.sensordata[[0, 2]])
    assert np.isfinite(batch.arrays()["state"]).all()
    assert (batch.sensordata[1] == 0).all()


def test_robot_pose_is_the_inverse_of_robot_qpos():
    poses = np.random.default_rng(0).uniform(-3, 3, (50, 3))
    np.testing.assert_allclose(robot_pose(robot_qpos(poses)), poses, atol=1e-12)


@pytest.mark.parametrize("form", ["inverse", "printed"])
def test_the_nose_signal_of_a_moved_spot_is_equation_3(form):
    batch = make_batch("spot_finding", 500, nose=form)
    random = np.random.default_rng(0)
    poses = random.uniform([-0.45, -0.3, -np.pi], [0.45, 0.3, np.pi], (500, 3))
    spots = random.uniform([-0.46, -0.29], [0.46, 0.29], (500, 2))
    batch.place_spot(np.arange(500), spots)
    batch.place(np.arange(500), poses)
    for pose, spot, signal in zip(poses, spots, batch.rules.reward(batch.sensordata), strict=True):
        nose = pose[:2] + 0.0275 * np.array([np.cos(pose[2]), np.sin(pose[2])])
        distance = np.hypot(*(spot - nose))
        off = np.arctan2(*(spot - nose)[::-1]) - pose[2]
        beta = abs((off + np.pi) % (2 * np.pi) - np.pi)
        ratio = 0.06 / distance if form == "inverse" else distance / 0.06
        raw = 10 if distance < 0.06 else max(0.0, 10 * ratio * (1 - 4 * beta / np.pi))
        if abs(distance - 0.06) > 1e-9:
            assert signal == pytest.approx(raw / (1 + raw), abs=1e-6)


def test_values_out_of_range_are_refused():
    with pytest.raises(ValueError, match="robots must be at least 1, got 0"):
        make_batch("wall_avoidance", 0)
    with pytest.raises(ValueError, match="threads must not be negative, got -1"):
        make_batch("wall_avoidance", 1, threads=-1)
    with pytest.raises(ValueError, match="task must be one of .*got 'dancing'"):
        make_batch("dancing", 1)
