"""The schedules are the paper's sections 3.1 and 3.2, and legs cut them without a gap."""

import dataclasses
import itertools
import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from musebot.models import Dimensions, arena_spec
from musebot.protocols.experiment.schedules import (
    PARTS,
    SCHEDULES,
    SPOT_FINDING,
    UPPER_LEFT,
    UPPER_RIGHT,
    WALL_AVOIDANCE,
    Phase,
    Schedule,
    control_steps,
)
from musebot.protocols.simulation.cohort import legs

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


def test_walls_are_to_be_avoided_and_the_spot_to_be_found():
    assert (WALL_AVOIDANCE.wanted, WALL_AVOIDANCE.unmeasured) == (False, "genius")
    assert (SPOT_FINDING.wanted, SPOT_FINDING.unmeasured) == (True, "ignorant")


@pytest.mark.parametrize(("start", "side"), [(UPPER_LEFT, -1), (UPPER_RIGHT, 1)])
def test_starts_are_ten_cm_from_both_walls_and_face_the_corner(start, side):
    arena = Dimensions.of(arena_spec().compile())
    x, y, heading = start
    corner = (side * arena.half_length, arena.half_width)
    assert abs(corner[0] - x) == pytest.approx(0.10)
    assert abs(corner[1] - y) == pytest.approx(0.10)
    assert heading == pytest.approx(math.atan2(corner[1] - y, corner[0] - x))


def test_wall_avoidance_places_the_robot_at_random_24_times_in_training():
    training = [leg for leg in legs(WALL_AVOIDANCE) if leg.phase.learning]
    assert len(training) == 24
    assert all(leg.phase.robot == "random" and leg.phase.spot is None for leg in training)
    assert all(leg.stop - leg.start == 3_000 for leg in training)


def test_spot_finding_moves_the_spot_4_times_in_training_and_never_the_robot():
    training = [leg for leg in legs(SPOT_FINDING) if leg.phase.learning]
    assert len(training) == 4
    assert all(leg.phase.spot == "random" and leg.phase.robot is None for leg in training)
    assert all(leg.stop - leg.start == 36_000 for leg in training)


@both
def test_every_test_is_placed_once_at_its_start(schedule):
    tests = [leg for leg in legs(schedule) if leg.phase.part != "training"]
    assert [leg.phase for leg in tests] == [p for p in schedule.phases if p.part != "training"]


def check_partition(schedule):
    """The legs follow one another from 0 to the end, and no leg outlasts a placement."""
    cuts = legs(schedule)
    assert cuts[0].start == 0
    assert cuts[-1].stop == sum(schedule.steps())
    assert all(before.stop == after.start for before, after in itertools.pairwise(cuts))
    assert all(leg.start < leg.stop for leg in cuts)
    starts = [0, *itertools.accumulate(schedule.steps())]
    for index, phase in enumerate(schedule.phases):
        own = [leg for leg in cuts if starts[index] <= leg.start < starts[index + 1]]
        assert own[0].start == starts[index]
        assert own[-1].stop == starts[index + 1]
        assert all(leg.phase == phase for leg in own)
        lengths = [leg.stop - leg.start for leg in own]
        if phase.every_minutes:
            assert set(lengths[:-1]) <= {control_steps(phase.every_minutes)}
            assert lengths[-1] <= control_steps(phase.every_minutes)
        else:
            assert len(own) == 1


@quick
@given(st.sampled_from(list(SCHEDULES.values())), st.floats(1e-4, 1))
def test_legs_cut_a_life_of_any_length_without_a_gap(schedule, factor):
    check_partition(schedule.scaled(factor))


phases = st.builds(
    Phase,
    part=st.sampled_from(["pre", "training", "post"]),
    minutes=st.floats(0, 5),
    learning=st.booleans(),
    every_minutes=st.none() | st.floats(0.001, 10),
)


@quick
@given(st.lists(phases, min_size=1, max_size=5))
def test_legs_cut_any_schedule_without_a_gap(drawn):
    # Equal phases in a row would hide which one a leg belongs to.
    distinct = [dataclasses.replace(p, spot=(float(i), 0.0)) for i, p in enumerate(drawn)]
    check_partition(Schedule("wall_avoidance", tuple(distinct), False, "genius"))


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
def test_a_factor_of_one_is_the_paper(schedule):
    assert schedule.scaled(1.0) == schedule


@quick
@given(st.floats(0, 300))
def test_minutes_are_rounded_to_the_nearest_control_step_of_a_tenth_of_a_second(minutes):
    steps = control_steps(minutes)
    assert isinstance(steps, int)
    assert steps >= 1
    assert steps == 1 or abs(steps - minutes * 600) <= 0.5 + 1e-9


@pytest.mark.parametrize("schedule", [WALL_AVOIDANCE, SPOT_FINDING])
def test_the_parts_of_a_life_follow_each_other_in_its_curve(schedule):
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


def test_schedules_cannot_be_changed():
    with pytest.raises(dataclasses.FrozenInstanceError):
        WALL_AVOIDANCE.phases = ()
    with pytest.raises(dataclasses.FrozenInstanceError):
        WALL_AVOIDANCE.phases[0].minutes = 1
