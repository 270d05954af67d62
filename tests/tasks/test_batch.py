"""The batch of robots and the dm_control environment are bit-exact."""

import dataclasses
import warnings

import numpy as np
import pytest

from musebot.models import Kinematics, robot_pose, robot_qpos
from musebot.tasks import ALL_TASKS, load, make_batch, make_kinematic_batch

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
    # The caller of a batch moves the spot.
    environment.task.episode = dataclasses.replace(environment.task.episode, spot_steps=0)
    batch = make_batch(task, 3)
    everyone = np.arange(3)
    timestep = environment.reset()
    batch.place_spot(everyone, np.tile(spot, (3, 1)))
    batch.place(everyone, np.tile(start, (3, 1)))
    touched = 0
    for step, motor in enumerate(scripted_motors(3000)):
        if step in (700, 1500):
            timestep = environment.reset(options={"robot": second})
            batch.place(everyone, np.tile(second, (3, 1)))
        if step == 2200:
            environment.physics.place_spot(-0.2, 0.1)
            batch.place_spot(everyone, np.tile([-0.2, 0.1], (3, 1)))
        np.testing.assert_array_equal(
            np.concatenate(list(timestep.observation.values())),
            batch.rules.state(batch.sensordata)[1],
        )
        timestep = environment.step(motor / 0.5 * environment.task.episode.limit)
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


def test_a_change_of_the_model_counts_in_each_physics_step():
    environment, batch = load("arena", "wall_avoidance"), make_batch("wall_avoidance", 2)
    environment.reset(options={"robot": (0.0, 0.0, 0.0)})
    for model in (environment.physics.model, batch.model):
        model.actuator_gainprm[:] *= 0.5
    flags = batch.model.opt.disableflags
    for _ in range(15):
        environment.step(np.array([0.5, 0.5]))
        batch.step(np.full((2, 2), 0.5))
    assert 0.1 < batch.pose[0, 0] < 0.2  # 0.28 m with the whole gain
    np.testing.assert_array_equal(batch.pose, [environment.physics.robot_pose()] * 2)
    assert batch.model.opt.disableflags == flags


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


@pytest.mark.parametrize("how", ["motor", "velocity", "escape along x", "escape along y"])
def test_an_unstable_robot_is_stopped_and_the_others_continue(how, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)  # MuJoCo writes its log into the working directory
    batch, twin = make_batch("wall_avoidance", 3), make_batch("wall_avoidance", 3)
    motors = np.full((3, 2), [0.3, 0.1])
    bad = motors.copy()
    if how == "motor":
        bad[1] = np.nan
    elif how == "velocity":
        batch.arrays()["state"][1, 10:] = np.inf
    else:  # no robot passes these walls: reduce the arena's size instead
        along_x, along_y = ([0.4, 0, 0], "half_length"), ([0, 0.3, 0], "half_width")
        place, name = along_x if how.endswith("x") else along_y
        batch.place(np.array([1]), np.array([place]))
        batch.dimensions = dataclasses.replace(batch.dimensions, **{name: max(place) - 0.01})
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
    with pytest.raises(ValueError, match="robots must be a whole number of at least 1, got 0"):
        make_batch("wall_avoidance", 0)
    with pytest.raises(ValueError, match="threads must be a whole number of at least 0, got -1"):
        make_batch("wall_avoidance", 1, threads=-1)
    with pytest.raises(ValueError, match="task must be one of .*got 'dancing'"):
        make_batch("dancing", 1)


def bodies():
    """Returns three robots in each simulator, in the middle of the arena."""
    return [
        make_batch("spot_finding_walls", 3),
        make_kinematic_batch("spot_finding_walls", 3, Kinematics()),
    ]


REFUSED = [
    ("place", (2, [0.1, 0.1, 0.1]), "robots must be indices"),
    ("place", ([1.0], [[0.1, 0.1, 0.1]]), "robots must be indices"),
    ("place", ([3], [[0.1, 0.1, 0.1]]), r"robots must lie in \[0, 2\]"),
    ("place", ([-1], [[0.1, 0.1, 0.1]]), r"robots must lie in \[0, 2\]"),
    ("place", ([0, 1], [0.1, 0.1, 0.1]), r"poses must be real numbers of shape \(2, 3\)"),
    ("place", ([0, 1], [[0.1, 0.1, 0.1]]), r"poses must be real numbers of shape \(2, 3\)"),
    ("place", ([0, 1], 0.5), r"poses must be real numbers of shape \(2, 3\)"),
    ("place", ([0], [[0.1, 0.1, 1j]]), "poses must be real numbers"),
    ("place", ([0, 1], [[0.1], [0.1, 0.2]]), "poses must be real numbers"),
    ("place_spot", ([0], [["a", "b"]]), r"spots must be real numbers of shape \(1, 2\)"),
    ("place_spot", ([0, 1], (0.1, 0.1)), r"spots must be real numbers of shape \(2, 2\)"),
    ("place_spot", ([0], 10**400), "spots must be real numbers"),
    ("step", ([0.1, 0.1],), r"motors must be real numbers of shape \(3, 2\)"),
    ("step", (np.zeros((1, 2)),), r"motors must be real numbers of shape \(3, 2\)"),
    ("step", (np.zeros((3, 2), complex),), "motors must be real numbers"),
    ("step", (np.zeros((3, 2), object),), "motors must be real numbers"),
]


@pytest.mark.parametrize("body", [0, 1], ids=["MuJoCo", "kinematic"])
@pytest.mark.parametrize(("name", "given", "sentence"), REFUSED)
def test_places_and_motors_of_a_wrong_shape_or_type_are_refused_and_change_nothing(
    body, name, given, sentence
):
    batch = bodies()[body]
    before = batch.get_state()
    with pytest.raises(ValueError, match=sentence):
        getattr(batch, name)(*given)
    for key, array in batch.get_state().items():
        np.testing.assert_array_equal(array, before[key])


@pytest.mark.parametrize("speed", [0, -1, float("nan"), float("inf"), 10**400, "fast", True, 1j])
def test_a_motor_speed_that_no_wheel_has_is_refused(speed):
    with pytest.raises(ValueError, match="motor_speed must be"):
        make_batch("wall_avoidance", 1, motor_speed=speed)


@pytest.mark.parametrize("body", [0, 1], ids=["MuJoCo", "kinematic"])
@pytest.mark.parametrize("how", ["stop", "motors", "NaN place", "NaN spot", "beyond the wall"])
def test_a_stopped_robot_senses_zeros_from_that_step_on(body, how):
    batch, twin = bodies()[body], bodies()[body]
    for robots in (batch, twin):
        robots.place_spot(np.arange(3), np.full((3, 2), 0.1))
        robots.place(np.arange(3), np.array([[0.0, 0.1, 0.0]] * 3))
    motors = np.full((3, 2), [0.3, 0.2])
    bad, one = motors.copy(), np.array([1])
    if how == "stop":
        batch.stop(one)
        assert (batch.sensordata[1] == 0).all()
    elif how == "motors":
        bad[1] = [0.1, np.inf]
    elif how == "NaN place":
        batch.place(one, np.array([[np.nan, 0, 0]]))
    elif how == "NaN spot":
        batch.place_spot(one, np.array([[np.nan, 0]]))
    else:
        batch.place(one, np.array([[0.0, 0.4, 0.0]]))
    for step in range(3):
        batch.step(bad if step == 0 else motors)
        twin.step(motors)
        assert batch.valid.tolist() == [True, False, True]
        assert (batch.sensordata[1] == 0).all()
        np.testing.assert_array_equal(batch.sensordata[[0, 2]], twin.sensordata[[0, 2]])
    assert np.isfinite(batch.pose).all() and (twin.sensordata[1] != 0).any()


@pytest.mark.parametrize("where", ["in the air", "on its back"])
def test_a_robot_off_the_floor_is_stopped(where):
    batch = make_batch("wall_avoidance", 3)
    qpos = batch.arrays()["state"][1, 1:10]
    if where == "in the air":
        qpos[2] = 5.0
    else:
        qpos[2:7] = [0.02, 0, 1, 0, 0]
    batch.step(np.zeros((3, 2)))
    assert batch.valid.tolist() == [True, False, True]


def test_huge_motors_are_clipped_without_a_warning():
    for batch in bodies():
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            batch.step(np.array([[1e308, 1e308], [-1e308, -1e308], [0, 0]]))
        assert batch.valid.all()


def both_simulators(robots):
    return (
        make_batch("wall_avoidance", robots),
        make_kinematic_batch("wall_avoidance", robots, Kinematics()),
    )


def test_a_stopped_robot_that_is_placed_still_senses_nothing():
    for batch in both_simulators(2):
        batch.stop(np.array([1]))
        batch.place(np.arange(2), np.full((2, 3), 0.1))
        assert batch.sensordata[0].any() and not batch.sensordata[1].any()


def test_a_robot_that_is_placed_at_a_wall_senses_the_same_whatever_it_did_before():
    wall = np.array([[0.525 - 0.0275, 0.0, 0.0]])
    for driven, fresh in zip(both_simulators(1), both_simulators(1), strict=True):
        for _ in range(3):
            driven.step(np.full((1, 2), 0.5))
        for batch in (driven, fresh):
            batch.place(np.array([0]), wall)
        np.testing.assert_array_equal(driven.sensordata, fresh.sensordata)
