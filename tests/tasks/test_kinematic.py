"""Robots in the kinematic simulator sense what robots in MuJoCo sense."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from musebot.models import Dimensions, Kinematics, arena_spec
from musebot.models.kinematic import follow_motors
from musebot.protocols.lives.cohort import Cohort
from musebot.protocols.lives.conditions import CohortKey, Condition
from musebot.protocols.lives.experiment import Experiment
from musebot.tasks import make_batch, make_kinematic_batch

SIZE = Dimensions.of(arena_spec().compile())
ROOM = np.array([SIZE.half_length, SIZE.half_width]) - SIZE.radius
BODIES = make_batch("spot_finding", 1), make_kinematic_batch("spot_finding", 1, Kinematics())


# In MuJoCo a rangefinder exactly on a wall sees the plane 1 mm behind it.
clear = st.tuples(
    st.floats(1e-5 - ROOM[0], ROOM[0] - 1e-5),
    st.floats(1e-5 - ROOM[1], ROOM[1] - 1e-5),
    st.floats(-np.pi, np.pi),
)


@settings(max_examples=50, deadline=None)
@given(clear, st.tuples(st.floats(-0.46, 0.46), st.floats(-0.29, 0.29)))
def test_both_simulators_sense_the_same(pose, spot):
    for batch in BODIES:
        batch.place_spot(np.array([0]), np.array([spot]))
        batch.place(np.array([0]), np.array([pose]))
    real, kinematic = BODIES
    layout = real.rules.layout
    for where in (layout.distances, slice(layout.smell.start, layout.smell.start + 2)):
        ours, theirs = kinematic.sensordata[0, where], real.sensordata[0, where]
        assert ours == pytest.approx(theirs, abs=1e-6)


def test_both_simulators_sense_the_same_with_wall_sensing():
    real, kinematic = (
        make_batch("spot_finding_walls", 3),
        make_kinematic_batch("spot_finding_walls", 3, Kinematics()),
    )
    for robots in (real, kinematic):
        robots.place_spot(np.arange(3), np.tile([0.3, 0.1], (3, 1)))
        robots.place(np.arange(3), np.array([[0.2, 0.1, 0.1], [-0.4, 0.2, 2.0], [0, -0.2, -1.0]]))
    ours, theirs = (robots.rules.state(robots.sensordata) for robots in (kinematic, real))
    np.testing.assert_allclose(ours, theirs, atol=1e-6)
    assert (ours[0, 0] > 0.3) & (ours[1:, 0] == 0).all()


def test_the_kinematic_simulator_refuses_other_arenas():
    for task in ("wall_avoidance_obstacles", "spot_finding_two_noses"):
        with pytest.raises(ValueError, match="must have the paper's arena, got"):
            make_kinematic_batch(task, 1, Kinematics())


def test_a_robot_that_is_placed_is_at_rest():
    batch = make_kinematic_batch("wall_avoidance", 2, Kinematics(lag=0.08))
    for _ in range(5):
        batch.step(np.full((2, 2), 0.5))
    rolling = batch.pose[1, 0]
    batch.place(np.array([0]), np.array([[0.1, 0.0, 0.3]]))
    batch.step(np.zeros((2, 2)))
    assert batch.pose[0] == pytest.approx([0.1, 0.0, 0.3], abs=1e-12)
    assert batch.pose[1, 0] > rolling + 0.005  # the other one rolls on


@pytest.mark.parametrize(("gap", "touches"), [(0.0004, True), (0.0006, False)])
def test_a_robot_that_is_placed_at_a_wall_senses_it_before_its_first_step(gap, touches):
    batch = make_kinematic_batch("wall_avoidance", 1, Kinematics())
    batch.place(np.array([0]), np.array([[ROOM[0] - gap, 0.0, 0.0]]))
    assert batch.rules.event(batch.sensordata).tolist() == [touches]


@pytest.mark.parametrize("gap", [0.0, 0.0004, 0.0006, 0.01])
def test_contact_is_a_gap_of_at_most_0_5_mm(gap):
    batch = make_kinematic_batch("wall_avoidance", 1, Kinematics())
    batch.place(np.array([0]), np.array([[0.1, ROOM[1] - gap, 0.3]]))
    batch.step(np.zeros((1, 2)))
    assert batch.rules.event(batch.sensordata)[0] == (gap <= 0.0005)


@pytest.mark.parametrize("wall", ["holds", "turns"])
def test_a_grazed_wall_turns_the_mujoco_body_and_the_simulator_with_turns(wall):
    kinematic = make_kinematic_batch("wall_avoidance", 4, Kinematics(wall=wall))
    headings = []
    for robots in (make_batch("wall_avoidance", 4), kinematic):
        # At each wall, 30 degrees from along it, with motors that turn slowly away from it.
        angles = np.radians([60, 150, 240, 330])
        places = [(ROOM[0], -0.2), (0.2, ROOM[1]), (-ROOM[0], 0.2), (-0.2, -ROOM[1])]
        robots.place(np.arange(4), np.column_stack([places, angles]))
        for _ in range(30):
            robots.step(np.array([[0.45, 0.5]] * 4))
        headings.append(np.degrees(robots.pose[:, 2] - angles) % 360)
    body, ours = headings
    assert (body < 15).all()  # of the 70 degrees commanded in three seconds
    assert (ours < 15).all() if wall == "turns" else (ours > 60).all()


PLAIN = Kinematics(wall="refuses", felt="pushed", pieces=1, path="euler")


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_robots_with_refused_moves_are_the_same_alone_and_in_a_batch(seed):
    random = np.random.default_rng(seed)
    poses = random.uniform([*-ROOM, -np.pi], [*ROOM, np.pi], (5, 3))
    steps = random.uniform(-0.5, 0.5, (40, 5, 2)).round(1)
    together = make_kinematic_batch("wall_avoidance", 5, PLAIN)
    together.place(np.arange(5), poses)
    alone = [make_kinematic_batch("wall_avoidance", 1, PLAIN) for _ in range(5)]
    for robot, pose in zip(alone, poses, strict=True):
        robot.place(np.array([0]), pose[None])
    before = together.pose
    for motors in steps:
        together.step(motors)
        for robot, own in zip(alone, motors, strict=True):
            robot.step(own[None])
        assert np.array_equal(together.pose, np.concatenate([r.pose for r in alone]))
        assert np.array_equal(together.sensordata, np.concatenate([r.sensordata for r in alone]))
        contact = together.rules.event(together.sensordata)
        stayed = (together.pose[:, :2] == before[:, :2]).all(axis=1)
        assert (stayed | ~contact).all()  # who moved was not refused
        assert (contact | ~stayed | (motors.sum(axis=1) == 0)).all()
        before = together.pose


@pytest.mark.parametrize("body", ["mujoco", "kinematic"])
def test_a_nose_at_the_centre_measures_from_the_robots_centre(body):
    experiment = Experiment(body=body, nose_place="centre")
    robots = experiment.batch("spot_finding", 2)
    robots.place_spot(np.arange(2), np.array([[0.1, 0.0], [0.0, 0.05]]))
    robots.place(np.arange(2), np.zeros((2, 3)))
    spot = robots.sensordata[:, robots.rules.layout.smell][:, :2]
    np.testing.assert_allclose(spot, [[0.1, 0], [0, 0.05]], atol=1e-9)
    assert robots.rules.event(robots.sensordata).tolist() == [False, True]


AT_THE_WALL = (ROOM[0], -0.2, 0.0)  # facing it


@pytest.mark.parametrize(
    ("motors", "near", "pushed"),
    [((0.5, 0.5), True, True), ((0, 0), True, False), ((-0.5, 0.5), True, False)],
    ids=["driving into it", "standing", "spinning"],
)
def test_the_mujoco_body_is_in_contact_only_while_it_pushes(motors, near, pushed):
    felt = []
    for batch in (
        make_batch("wall_avoidance", 1),
        make_kinematic_batch("wall_avoidance", 1, Kinematics(felt="pushed")),
        make_kinematic_batch("wall_avoidance", 1, Kinematics()),
    ):
        batch.place(np.array([0]), np.array([AT_THE_WALL]))
        for _ in range(10):
            batch.step(np.array([motors]))
        felt.append(bool(batch.rules.event(batch.sensordata)[0]))
    assert felt == [pushed, pushed, near]


def test_contact_within_a_control_step_counts_with_any_contact_only():
    # An arc that moves the rim 0.3 mm towards the wall and back within a control step.
    start = np.array([[0.1, ROOM[1] - 0.0006, 0.08]])
    arc = np.array([[0.5, 0.3]])
    touched = []
    for any_contact in (False, True):
        batch = make_kinematic_batch(
            "wall_avoidance", 1, Kinematics(any_contact=any_contact, pieces=10)
        )
        batch.place(np.array([0]), start)
        batch.step(arc)
        touched.append(bool(batch.rules.event(batch.sensordata)[0]))
    assert touched == [False, True]


@given(st.floats(0.01, 0.5), st.floats(-0.5, 0.5), st.integers(1, 8))
def test_a_lag_costs_its_time_constant_times_the_speed(lag, motor, pieces):
    batch = make_kinematic_batch("wall_avoidance", 1, Kinematics(lag=lag, pieces=pieces))
    batch.place(np.array([0]), np.zeros((1, 3)))
    batch.step(np.full((1, 2), motor))
    rest = np.exp(-0.1 / lag)  # fraction of the difference that remains after a control step
    speed = 2 * SIZE.motor_speed * motor
    assert batch.pose[0, 0] == pytest.approx(speed * (0.1 - lag * (1 - rest)), abs=1e-9)
    np.testing.assert_allclose(batch.arrays()["wheels"], motor * (1 - rest), atol=1e-12)


def test_the_gains_do_not_change_the_precision_of_the_motors(monkeypatch):
    # Results depend on it to the byte: the wheels' lag is computed in the commands' precision.
    commands = []

    def spy(wheels, motors, seconds, lag):
        commands.append(motors)
        return follow_motors(wheels, motors, seconds, lag)

    monkeypatch.setattr("musebot.tasks.kinematic.robots.follow_motors", spy)
    make_kinematic_batch("wall_avoidance", 2, Kinematics()).step(np.full((2, 2), 0.1, np.float32))
    assert {motors.dtype for motors in commands} == {np.dtype(np.float32)}


def test_a_lag_of_0_08_s_is_that_of_the_mujoco_body():
    seconds = 2
    lost = []
    for batch in (
        make_batch("wall_avoidance", 1),
        make_kinematic_batch("wall_avoidance", 1, Kinematics(lag=0.08)),
    ):
        batch.place(np.array([0]), np.array([[-0.4, 0, 0]]))
        for _ in range(10 * seconds):
            batch.step(np.full((1, 2), 0.5))
        lost.append(seconds - (batch.pose[0, 0] + 0.4) / SIZE.motor_speed)
    assert lost[0] == pytest.approx(lost[1], abs=0.01)  # seconds of driving at full speed


def test_equal_seeds_give_equal_brains_in_both_simulators():
    key = CohortKey(Condition("spot_finding", "creative"), 0)
    real, kinematic = (
        Cohort(Experiment(cohort_size=2, body=body), key) for body in ("mujoco", "kinematic")
    )
    for name, weights in real.agent.weights().items():
        assert np.array_equal(weights, kinematic.agent.weights()[name])
