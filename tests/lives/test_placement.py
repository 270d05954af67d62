"""Where a schedule places robots and spots, and the legs between two placements."""

import dataclasses
import itertools

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from musebot.models import Dimensions, arena_spec
from musebot.protocols.lives.placement import legs, place
from musebot.protocols.lives.schedules import (
    SCHEDULES,
    SPOT_FINDING,
    WALL_AVOIDANCE,
    Phase,
    Schedule,
    control_steps,
)

quick = settings(deadline=None, max_examples=100)
both = pytest.mark.parametrize("schedule", SCHEDULES.values(), ids=SCHEDULES)


# Legs


def test_wall_avoidance_places_robots_at_random_24_times_in_training():
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
def test_robots_are_placed_once_at_the_start_of_each_test(schedule):
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


# Placements


class Recorder:
    """A batch that keeps what it is told."""

    def __init__(self, dimensions, robots):
        self.dimensions = dimensions
        self.robots = robots
        self.calls = []

    def place(self, which, poses):
        self.calls.append(("robots", which.tolist(), poses.tolist()))

    def place_spot(self, which, spots):
        self.calls.append(("spots", which.tolist(), spots.tolist()))


@pytest.fixture
def batch():
    return Recorder(Dimensions.of(arena_spec().compile()), 2)


def test_spots_are_placed_before_robots_so_that_robots_sense_the_new_ones(batch):
    phase = Phase("pre", 1, False, robot=(0.1, 0.2, 0.3), spot=(0.4, 0.5))
    place(batch, phase, np.random.default_rng(0))
    assert batch.calls == [
        ("spots", [0, 1], [[0.4, 0.5]] * 2),
        ("robots", [0, 1], [[0.1, 0.2, 0.3]] * 2),
    ]


def test_what_a_phase_does_not_place_stays(batch):
    place(batch, Phase("training", 1, True), np.random.default_rng(0))
    assert batch.calls == []


def test_random_places_differ_between_robots_and_come_from_the_given_stream(batch):
    phase = Phase("training", 1, True, robot="random", spot="random")
    for seed in (0, 0, 1):
        place(batch, phase, np.random.default_rng(seed))
    first, again, other = batch.calls[:2], batch.calls[2:4], batch.calls[4:]
    assert first == again != other
    assert [what for what, _, _ in first] == ["spots", "robots"]
    for _, _, (one, two) in first:
        assert all(a != b for a, b in zip(one, two, strict=True))
