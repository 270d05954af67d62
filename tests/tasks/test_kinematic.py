"""Robots in the kinematic simulator sense what robots in MuJoCo sense."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from musebot.models import Dimensions, Kinematics, arena_spec
from musebot.protocols.runs.experiment import Experiment
from musebot.tasks import make_batch, make_kinematic_batch

SIZE = Dimensions.of(arena_spec().compile())
ROOM = np.array([SIZE.half_length, SIZE.half_width]) - SIZE.radius


def test_the_kinematic_simulator_refuses_other_arenas():
    for task in ("wall_avoidance_obstacles", "spot_finding_two_noses"):
        with pytest.raises(ValueError, match=f"robot and arena only, unlike {task}"):
            make_kinematic_batch(task, 1, Kinematics())


def test_contact_is_a_gap_of_at_most_0_5_mm():
    batch, gaps = make_kinematic_batch("wall_avoidance", 4, Kinematics()), [0, 4e-4, 6e-4, 0.01]
    batch.place(np.arange(4), np.array([[0.1, ROOM[1] - gap, 0.3] for gap in gaps]))
    for _ in range(2):  # when it is placed, and after a step
        assert batch.rules.event(batch.sensordata).tolist() == [True, True, False, False]
        batch.step(np.zeros((4, 2)))


def test_a_robot_slips_along_each_wall_as_the_mujoco_body_does():
    kinematic = make_kinematic_batch("wall_avoidance", 4, Kinematics(wall="slips", lag=0.08))
    slipped = []
    for robots in (make_batch("wall_avoidance", 4), kinematic):
        # At each wall, 10 degrees from along it.
        angles = np.radians([80, 170, -100, -10])
        places = [(ROOM[0], -0.2), (0.2, ROOM[1]), (-ROOM[0], 0.2), (-0.2, -ROOM[1])]
        robots.place(np.arange(4), np.column_stack([places, angles]))
        for _ in range(20):
            robots.step(np.full((4, 2), 0.5))
        moved = robots.pose - np.column_stack([places, angles])
        slipped.append(np.abs(moved[:, :2]).max(axis=1))
        assert np.degrees(np.abs(moved[:, 2])).max() < 2
    np.testing.assert_allclose(*slipped, rtol=0.12)
    assert slipped[0].min() > 0.2


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


def test_the_mujoco_body_is_in_contact_only_while_it_pushes():
    for batch, contact in (
        (make_batch("wall_avoidance", 3), [True, False, False]),
        (
            make_kinematic_batch("wall_avoidance", 3, Kinematics(felt="pushed")),
            [True, False, False],
        ),
        (make_kinematic_batch("wall_avoidance", 3, Kinematics()), [True, True, True]),
    ):
        batch.place(np.arange(3), np.array([AT_THE_WALL] * 3))
        for _ in range(10):  # driving into it, standing, spinning
            batch.step(np.array([(0.5, 0.5), (0, 0), (-0.5, 0.5)]))
        assert batch.rules.event(batch.sensordata).tolist() == contact


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
