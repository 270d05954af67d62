"""The kinematic simulator moves as geometry requires, and at walls as measured in MuJoCo."""

import dataclasses

import numpy as np
import pytest
from hypothesis import assume, example, given
from hypothesis import strategies as st

from musebot.models import Dimensions, arena_spec
from musebot.models.kinematic import WALLS, Kinematics, drive, gaps, grip

SIZE = Dimensions.of(arena_spec().compile())
ROOM = np.array([SIZE.half_length, SIZE.half_width]) - SIZE.radius
SLIPS = Kinematics(wall="slips")

motors = st.floats(-0.5, 0.5)
poses = st.tuples(
    st.floats(-ROOM[0], ROOM[0]), st.floats(-ROOM[1], ROOM[1]), st.floats(-np.pi, np.pi)
)


def driven(pose, left, right, seconds=0.1, wall="holds"):
    how = Kinematics(wall=wall)
    return drive(np.array([pose]), np.array([[left, right]]), seconds, how, SIZE)[0][0]


@example(0.25, 0.25, 0.3)  # straight
@example(-0.5, 0.5, 0.0)  # in place
@given(motors, motors, st.floats(-np.pi, np.pi))
def test_an_arc_ends_where_1000_short_straight_steps_end(left, right, heading):
    x = y = 0.0
    angle, n = heading, 1000
    turn = (right - left) * 2 * SIZE.motor_speed / SIZE.wheel_base * 0.1 / n
    for _ in range(n):
        x += (left + right) * SIZE.motor_speed * 0.1 / n * np.cos(angle + turn / 2)
        y += (left + right) * SIZE.motor_speed * 0.1 / n * np.sin(angle + turn / 2)
        angle += turn
    assert driven((0, 0, heading), left, right) == pytest.approx([x, y, angle], abs=1e-7)


@given(poses, motors, motors, st.sampled_from(WALLS))
def test_no_robot_enters_a_wall(pose, left, right, wall):
    assert gaps(driven(pose, left, right, wall=wall)[None], SIZE)[0] >= -1e-12


def test_a_robot_that_drives_into_a_wall_is_held_slides_or_sticks():
    start = (ROOM[0], 0.0, np.pi / 4)  # at the east wall, facing north-east
    held, slid, stuck = (
        driven(start, 0.4, 0.5, wall=wall) for wall in ("holds", "slides", "sticks")
    )
    turned = 0.1 * 2 * SIZE.motor_speed * 0.1 / SIZE.wheel_base
    assert held == pytest.approx([ROOM[0], 0, np.pi / 4 + turned])
    assert slid[0] == pytest.approx(ROOM[0])
    assert slid[1] > 0.01
    assert slid[2] == pytest.approx(np.pi / 4 + turned)
    assert stuck == pytest.approx(start)


REFUSES = Kinematics(wall="refuses", felt="pushed", pieces=1, path="euler")


@given(poses, motors, motors)
def test_a_move_is_refused_if_its_end_overlaps_a_wall_and_else_is_an_euler_step(pose, left, right):
    turn = (right - left) * 2 * SIZE.motor_speed * 0.1 / SIZE.wheel_base
    reach = (left + right) * SIZE.motor_speed * 0.1
    x, y, heading = pose
    end = np.array([x + reach * np.cos(heading), y + reach * np.sin(heading)])
    assume((np.abs(np.abs(end) - ROOM) > 1e-12).all())
    overlaps = bool((np.abs(end) > ROOM).any())
    moved, refused = driven_as(REFUSES, pose, left, right)
    assert refused == overlaps
    if refused:
        assert tuple(moved[:2]) == pose[:2]
    else:
        assert moved[:2] == pytest.approx(end, abs=1e-12)
    assert moved[2] == pytest.approx(heading + turn, abs=1e-12)  # at a wall as in the open


def driven_as(how, pose, left, right):
    after, pushing = drive(np.array([pose]), np.array([[left, right]]), 0.1, how, SIZE)
    return after[0], bool(pushing[0])


def test_a_robot_can_reverse_from_a_wall():
    for wall in WALLS:
        moved = driven((ROOM[0], 0, 0), -0.5, -0.5, wall=wall)
        assert moved == pytest.approx([ROOM[0] - 0.02, 0, 0])


@given(st.floats(0.05, 0.5), st.floats(0, 89), st.sampled_from([-1, 1]))
def test_a_robot_slips_along_a_wall_as_coulombs_law_says(motor, degrees, side):
    angle, speed = np.radians(degrees), 2 * SIZE.motor_speed * motor
    slipped = max(0.0, speed - grip(SIZE) * np.cos(angle)) * np.sin(angle) * 0.1
    for turned in (0, np.pi):  # ahead and backwards
        moved = driven(
            (ROOM[0], 0.0, turned + side * angle),
            *(motor if turned == 0 else -motor for _ in range(2)),
            wall="slips",
        )
        assert moved == pytest.approx([ROOM[0], side * slipped, turned + side * angle], abs=1e-12)


def test_a_robot_that_grazes_a_wall_slips_into_the_corner():
    wall, way = np.array([ROOM[0], ROOM[1] - 0.001]), np.radians(80)
    for pieces in (1, 4):
        after = np.array([[*wall, way]])
        for _ in range(pieces):
            after = drive(after, np.full((1, 2), 0.5), 0.1 / pieces, SLIPS, SIZE)[0]
        assert after[0, :2] == pytest.approx(ROOM, abs=1e-12)
        assert drive(after, np.full((1, 2), 0.5), 0.1, SLIPS, SIZE)[0] == pytest.approx(after)


def test_a_given_size_replaces_that_of_the_body():
    changed = Kinematics(radius=0.02, wheel_base=0.04).applied_to(SIZE)
    assert changed == dataclasses.replace(SIZE, radius=0.02, wheel_base=0.04, nose=0.02)
    assert Kinematics().applied_to(SIZE) == SIZE
    with pytest.raises(ValueError, match=r"radius must be a number in \(0, 0.1\) m"):
        Kinematics(radius=0.4)
    central = dataclasses.replace(SIZE, nose=0.0)
    assert Kinematics(radius=0.02).applied_to(central).nose == 0
