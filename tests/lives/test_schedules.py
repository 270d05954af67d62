"""The schedules are those of sections 3.1 and 3.2."""

import dataclasses
import itertools
import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from musebot.models import Dimensions, arena_spec
from musebot.protocols.lives.schedules import (
    CONTINUAL,
    PARTS,
    PROTOCOLS,
    SCHEDULES,
    SPOT_FINDING,
    UPPER_LEFT,
    UPPER_RIGHT,
    WALL_AVOIDANCE,
    WALLS_SENSED,
    Phase,
    control_steps,
)

quick = settings(deadline=None, max_examples=100)
both = pytest.mark.parametrize("schedule", SCHEDULES.values(), ids=SCHEDULES)


def test_there_is_a_schedule_for_each_task_under_its_name():
    assert SCHEDULES == {"wall_avoidance": WALL_AVOIDANCE, "spot_finding": SPOT_FINDING}
    assert all(schedule.task == task for task, schedule in SCHEDULES.items())


def test_a_life_of_wall_avoidance_is_96000_control_steps():
    assert WALL_AVOIDANCE.steps() == [6_000, 6_000, 72_000, 6_000, 6_000]
    assert sum(WALL_AVOIDANCE.steps()) == 96_000


def test_a_life_of_spot_finding_is_216000_control_steps():
    assert SPOT_FINDING.steps() == [36_000, 144_000, 36_000]
    assert sum(SPOT_FINDING.steps()) == 216_000


def test_wall_avoidance_tests_ten_minutes_in_each_upper_corner():
    left, right, training, *_ = WALL_AVOIDANCE.phases
    assert left == Phase("pre", 10, learning=False, robot=UPPER_LEFT)
    assert right == Phase("pre", 10, learning=False, robot=UPPER_RIGHT)
    assert training == Phase("training", 120, learning=True, robot="random", every_minutes=5)


def test_spot_finding_tests_an_hour_from_the_upper_left_to_a_spot_in_the_upper_right():
    pre, training, _ = SPOT_FINDING.phases
    assert pre == Phase("pre", 60, learning=False, robot=UPPER_LEFT, spot=UPPER_RIGHT[:2])
    assert training == Phase("training", 240, learning=True, spot="random", every_minutes=60)


@both
def test_the_test_after_training_is_the_one_before(schedule):
    pre = [phase for phase in schedule.phases if phase.part == "pre"]
    post = [phase for phase in schedule.phases if phase.part == "post"]
    assert [dataclasses.replace(phase, part="pre") for phase in post] == pre
    parts = [part for part, _ in itertools.groupby(schedule.phases, key=lambda p: p.part)]
    assert parts == ["pre", "training", "post"]


@both
def test_robots_learn_in_training_and_only_there(schedule):
    assert all(phase.learning == (phase.part == "training") for phase in schedule.phases)


def test_contact_is_unwanted_and_the_spot_is_wanted():
    assert (WALL_AVOIDANCE.wanted, WALL_AVOIDANCE.unmeasured) == (False, "genius")
    assert (SPOT_FINDING.wanted, SPOT_FINDING.unmeasured) == (True, "ignorant")


@pytest.mark.parametrize(("start", "side"), [(UPPER_LEFT, -1), (UPPER_RIGHT, 1)])
def test_starts_are_10_cm_from_both_walls_and_face_the_corner(start, side):
    arena = Dimensions.of(arena_spec().compile())
    x, y, heading = start
    corner = (side * arena.half_length, arena.half_width)
    assert abs(corner[0] - x) == pytest.approx(0.10)
    assert abs(corner[1] - y) == pytest.approx(0.10)
    assert heading == pytest.approx(math.atan2(corner[1] - y, corner[0] - x))


@quick
@given(st.sampled_from(list(SCHEDULES.values())), st.floats(1e-4, 1))
def test_scaling_multiplies_durations_and_nothing_else(schedule, factor):
    scaled = schedule.scaled(factor)
    for phase, short in zip(schedule.phases, scaled.phases, strict=True):
        assert short.minutes == pytest.approx(phase.minutes * factor)
        if phase.every_minutes:
            assert short.every_minutes == pytest.approx(phase.every_minutes * factor)
        restored = dataclasses.replace(
            short, minutes=phase.minutes, every_minutes=phase.every_minutes
        )
        assert restored == phase
    assert dataclasses.replace(scaled, phases=schedule.phases) == schedule


@both
def test_a_factor_of_one_changes_nothing(schedule):
    assert schedule.scaled(1.0) == schedule


@quick
@given(st.floats(0, 300))
def test_minutes_are_rounded_to_the_nearest_control_step_of_a_tenth_of_a_second(minutes):
    steps = control_steps(minutes)
    assert isinstance(steps, int)
    assert steps >= 1
    assert steps == 1 or abs(steps - minutes * 600) <= 0.5 + 1e-9


@pytest.mark.parametrize("schedule", [WALL_AVOIDANCE, SPOT_FINDING])
def test_the_parts_of_a_life_follow_one_another_in_its_curve(schedule):
    minutes = [schedule.minutes_of(part) for part in PARTS]
    assert [part.start for part in minutes] == [0, *(part.stop for part in minutes[:-1])]
    lengths = [sum(p.minutes for p in schedule.phases if p.part == part) for part in PARTS]
    assert [part.stop - part.start for part in minutes] == lengths
    assert sum(map(schedule.steps_of, PARTS)) == sum(schedule.steps())


@pytest.mark.parametrize("factor", [0.001, 0.004, 0.01, 0.3])
def test_no_part_of_a_rehearsal_is_without_a_minute(factor):
    schedule = SPOT_FINDING.scaled(factor)
    curve = np.zeros(-(-sum(schedule.steps()) // control_steps(1)))
    assert all(len(curve[schedule.minutes_of(part)]) for part in PARTS)


def test_the_protocols_beyond_the_paper_have_spot_finding_only():
    assert PROTOCOLS["paper"] == SCHEDULES
    assert PROTOCOLS["continual"] == {"spot_finding": CONTINUAL}
    assert PROTOCOLS["walls"] == {"spot_finding": WALLS_SENSED}


def test_the_continual_protocol_is_24_hours_in_which_the_spot_moves_every_ten_minutes():
    pre, training, post = CONTINUAL.phases
    assert (pre, post) == (SPOT_FINDING.phases[0], SPOT_FINDING.phases[2])
    assert training == Phase("training", 1440, learning=True, spot="random", every_minutes=10)
    assert dataclasses.replace(CONTINUAL, phases=SPOT_FINDING.phases) == SPOT_FINDING


def test_the_protocol_walls_is_spot_finding_in_another_task():
    assert WALLS_SENSED.task == "spot_finding_walls"
    assert dataclasses.replace(WALLS_SENSED, task="spot_finding") == SPOT_FINDING


def test_schedules_cannot_be_changed():
    with pytest.raises(dataclasses.FrozenInstanceError):
        WALL_AVOIDANCE.phases = ()
    with pytest.raises(dataclasses.FrozenInstanceError):
        WALL_AVOIDANCE.phases[0].minutes = 1


def test_a_turned_schedule_turns_fixed_poses_and_nothing_else():
    turned = WALL_AVOIDANCE.turned(0.25)
    for before, after in zip(WALL_AVOIDANCE.phases, turned.phases, strict=True):
        if before.robot == "random":
            assert after == before
        else:
            x, y, heading = before.robot
            assert after == dataclasses.replace(before, robot=(x, y, heading + 0.25))
