"""Schedules: those of sections 3.1 and 3.2, and laws of any schedule."""

import dataclasses
import itertools
import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from musebot.models import Dimensions, arena_spec
from musebot.tasks.lives import (
    PROTOCOLS,
    SCHEDULES,
    SPOT_FINDING,
    STAGES,
    UPPER_LEFT,
    UPPER_RIGHT,
    WALL_AVOIDANCE,
    WALLS_SENSED,
    Phase,
    Schedule,
    control_steps,
    place,
)

coordinates = st.floats(-0.5, 0.5)
poses = st.tuples(coordinates, coordinates, st.floats(-4, 4))
phases = st.builds(
    Phase,
    stage=st.sampled_from(STAGES),
    minutes=st.floats(0, 5),
    learning=st.booleans(),
    robot=st.none() | st.just("random") | poses,
    spot=st.none() | st.just("random") | st.tuples(coordinates, coordinates),
    every_minutes=st.none() | st.floats(0.001, 10),
)


@st.composite
def schedules(draw):
    """A protocol's schedule, shortened, or any phases in the order of their stages."""
    if draw(st.booleans()):
        schedule = draw(st.sampled_from([*SCHEDULES.values(), WALLS_SENSED]))
        return schedule.scaled(draw(st.floats(1e-4, 1)))
    drawn = draw(st.lists(phases, min_size=1, max_size=5))
    drawn.sort(key=lambda phase: STAGES.index(phase.stage))
    return Schedule("wall_avoidance", tuple(drawn), False, "genius")


# The paper's; test_cohort.py has the steps of sections 3.1 and 3.2


def test_walls_are_sensed_in_a_task_of_their_own():
    assert WALLS_SENSED == dataclasses.replace(SPOT_FINDING, task="spot_finding_walls")
    assert SCHEDULES == {"wall_avoidance": WALL_AVOIDANCE, "spot_finding": SPOT_FINDING}
    assert PROTOCOLS == {"paper": SCHEDULES, "walls": {"spot_finding": WALLS_SENSED}}
    assert WALL_AVOIDANCE.steps() == [6_000, 6_000, 72_000, 6_000, 6_000]
    assert SPOT_FINDING.steps() == [36_000, 144_000, 36_000]


def test_starts_are_10_cm_from_both_walls_and_face_the_corner():
    arena = Dimensions.of(arena_spec().compile())
    for (x, y, heading), side in ((UPPER_LEFT, -1), (UPPER_RIGHT, 1)):
        away = side * arena.half_length - x, arena.half_width - y
        assert np.abs(away) == pytest.approx([0.1, 0.1])
        assert heading == pytest.approx(math.atan2(away[1], away[0]))


# Any


@given(st.floats(0, 300))
def test_minutes_are_rounded_to_the_nearest_control_step_of_a_tenth_of_a_second(minutes):
    steps = control_steps(minutes)
    assert isinstance(steps, int) and steps >= 1
    assert steps == 1 or abs(steps - minutes * 600) <= 0.5 + 1e-9


@given(schedules())
def test_legs_cut_a_life_at_every_placement_without_a_gap(schedule):
    legs = schedule.legs()
    starts = [0, *itertools.accumulate(schedule.steps())]
    assert legs[0].start == 0 and legs[-1].stop == starts[-1]
    assert all(before.stop == after.start for before, after in itertools.pairwise(legs))
    assert {*starts} <= {0, *(leg.stop for leg in legs)}
    for phase, start, stop in zip(schedule.phases, starts, starts[1:], strict=False):
        own = [leg for leg in legs if start <= leg.start < stop]
        assert all(leg.phase is phase for leg in own)
        period = control_steps(phase.every_minutes) if phase.every_minutes else stop - start
        assert all(leg.stop - leg.start == period for leg in own[:-1])
        assert 0 < own[-1].stop - own[-1].start <= period


@given(schedules())
def test_stages_share_the_steps_and_the_minutes_of_a_life(schedule):
    steps = [schedule.steps_of(stage) for stage in STAGES]
    assert sum(steps) == sum(schedule.steps()) == schedule.steps_of_minutes().sum()
    assert (schedule.steps_of_minutes()[:-1] == 600).all()
    stops = schedule.steps_of_minutes().cumsum()
    starts = stops - schedule.steps_of_minutes()  # the last minute may be shorter
    end = 0
    for stage, own in zip(STAGES, steps, strict=True):
        minutes, start, end = schedule.minutes_of(stage), end, end + own
        within = (stops > start) & (starts < end)
        if own:
            assert [*range(len(stops))[minutes]] == [*np.flatnonzero(within)], stage


def unchanged_but(schedule, changed, *fields):
    """Asserts that only some fields of phases have changed; returns pairs of the phases."""
    pairs = [*zip(schedule.phases, changed.phases, strict=True)]
    assert dataclasses.replace(changed, phases=schedule.phases) == schedule
    for old, new in pairs:
        assert dataclasses.replace(new, **{name: getattr(old, name) for name in fields}) == old
    return pairs


@given(schedules(), st.floats(1e-4, 1))
def test_scaling_multiplies_durations_and_nothing_else(schedule, factor):
    scaled = schedule.scaled(factor)
    for old, new in unchanged_but(schedule, scaled, "minutes", "every_minutes"):
        assert new.minutes == old.minutes * factor
        assert new.every_minutes == (old.every_minutes and old.every_minutes * factor)
    assert schedule.scaled(1.0) == schedule


@given(schedules(), st.floats(0, 1), st.floats(0, 1), st.floats(-4, 4))
def test_moving_moves_fixed_places_away_from_the_centre_and_turns_poses(schedule, x, y, angle):
    moved = schedule.moved(x, y, angle)
    for old, new in unchanged_but(schedule, moved, "robot", "spot"):
        for before, after in ((old.robot, new.robot), (old.spot, new.spot)):
            if not isinstance(before, tuple):
                assert after == before
                continue
            assert after[2:] == tuple(heading + angle for heading in before[2:])
            for now, earlier, by in zip(after, before, (x, y), strict=False):
                assert abs(now) == pytest.approx(abs(earlier) + by) and now * earlier >= 0


# Placements


class Recorder:
    """Robots that keep what they are given."""

    def __init__(self):
        self.dimensions, self.robots = Dimensions.of(arena_spec().compile()), 2
        self.calls = []
        for name, what in (("place", "robots"), ("place_spot", "spots")):
            setattr(self, name, lambda *given, what=what: self.calls.append((what, *given)))


@given(phases)
def test_a_phase_places_spots_before_robots_and_what_it_does_not_place_stays(phase):
    first, again, other = Recorder(), Recorder(), Recorder()
    for batch, seed in ((first, 0), (again, 0), (other, 1)):
        place(batch, phase, np.random.default_rng(seed))
    given_places = {"spots": phase.spot, "robots": phase.robot}
    wanted = [what for what, where in given_places.items() if where is not None]
    assert [what for what, *_ in first.calls] == wanted  # robots sense the new spots
    np.testing.assert_equal(first.calls, again.calls)
    for (what, which, places), (_, _, others) in zip(first.calls, other.calls, strict=True):
        assert which.tolist() == [0, 1]
        if given_places[what] == "random":
            assert (places[0] != places[1]).all() and (places != others).all()
        else:
            assert places.tolist() == [[*given_places[what]]] * 2
