"""Lives: those of sections 3.1 and 3.2, those that change, and laws of any life."""

import dataclasses
import itertools
import json
import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from strategies import worlds

from musebot.models import Dimensions, arena_spec
from musebot.tasks.episode import CONTROL_TIMESTEP
from musebot.tasks.lives import (
    CHANGING,
    LIVES,
    SPOT_FINDING,
    STAGES,
    UPPER_LEFT,
    UPPER_RIGHT,
    WALL_AVOIDANCE,
    WALLS_SENSED,
    Life,
    Phase,
    control_steps,
    life_from,
    life_named,
    place,
)
from musebot.tasks.starts import Start
from musebot.tasks.world import World

coordinates = st.floats(-0.5, 0.5)
poses = st.tuples(coordinates, coordinates, st.floats(-4, 4))
phases = st.builds(
    Phase,
    stage=st.sampled_from(STAGES),
    minutes=st.floats(0, 5),
    learning=st.booleans(),
    robot=st.none() | st.just("random") | poses,
    spot=st.none() | st.just("random") | st.tuples(coordinates, coordinates),
    every_minutes=st.none() | st.floats(0.002, 10),
    world=st.just(World()) | worlds,
)


@st.composite
def any_life(draw):
    """A built-in life, shortened, or any phases in the order of their stages."""
    if draw(st.booleans()):
        life = draw(st.sampled_from([*LIVES.values()]))
        return life.scaled(draw(st.floats(1e-4, 1)))
    drawn = draw(st.lists(phases, min_size=1, max_size=5))
    before = [phase for phase in drawn if phase.stage == "pre"]
    if before and any(phase.stage == "post" for phase in drawn):  # equally long tests
        drawn = [phase for phase in drawn if phase.stage != "post"]
        drawn += [dataclasses.replace(phase, stage="post") for phase in before]
    drawn.sort(key=lambda phase: STAGES.index(phase.stage))
    return Life("mine", "Mine", "wall_avoidance", tuple(drawn), False, "genius")


# The paper's; test_cohort.py has the steps of sections 3.1 and 3.2


def test_walls_are_sensed_in_a_life_of_their_own():
    same = {name: getattr(SPOT_FINDING, name) for name in ("name", "title", "task")}
    assert dataclasses.replace(WALLS_SENSED, **same) == SPOT_FINDING
    assert WALLS_SENSED.task == "spot_finding_walls"
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


@given(any_life())
def test_legs_cut_a_life_at_every_placement_without_a_gap(life):
    legs = life.legs()
    starts = [0, *itertools.accumulate(life.steps())]
    assert legs[0].start == 0 and legs[-1].stop == starts[-1]
    assert all(before.stop == after.start for before, after in itertools.pairwise(legs))
    assert {*starts} <= {0, *(leg.stop for leg in legs)}
    borders = zip(life.phases, starts, starts[1:], strict=False)
    for number, (phase, start, stop) in enumerate(borders):
        own = [leg for leg in legs if start <= leg.start < stop]
        assert all(leg.phase is phase and leg.number == number for leg in own)
        changes = number > 0 and life.phases[number - 1].world != phase.world
        assert [leg.changes_world for leg in own] == [changes] + [False] * (len(own) - 1)
        period = control_steps(phase.every_minutes) if phase.every_minutes else stop - start
        assert all(leg.stop - leg.start == period for leg in own[:-1])
        assert 0 < own[-1].stop - own[-1].start <= period


@given(any_life())
def test_stages_share_the_steps_and_the_minutes_of_a_life(life):
    steps = [life.steps_of(stage) for stage in STAGES]
    assert sum(steps) == sum(life.steps()) == life.steps_of_minutes().sum()
    assert (life.steps_of_minutes()[:-1] == 600).all()
    stops = life.steps_of_minutes().cumsum()
    starts = stops - life.steps_of_minutes()  # the last minute may be shorter
    end = 0
    for stage, own in zip(STAGES, steps, strict=True):
        minutes, start, end = life.minutes_of(stage), end, end + own
        within = (stops > start) & (starts < end)
        if own:
            assert [*range(len(stops))[minutes]] == [*np.flatnonzero(within)], stage


def unchanged_but(life, changed, *fields):
    """Asserts that only some fields of phases have changed; returns pairs of the phases."""
    pairs = [*zip(life.phases, changed.phases, strict=True)]
    assert dataclasses.replace(changed, phases=life.phases) == life
    for old, new in pairs:
        assert dataclasses.replace(new, **{name: getattr(old, name) for name in fields}) == old
    return pairs


@given(any_life(), st.floats(1e-4, 1))
def test_scaling_multiplies_durations_and_nothing_else(life, factor):
    scaled = life.scaled(factor)
    for old, new in unchanged_but(life, scaled, "minutes", "every_minutes"):
        assert new.minutes == old.minutes * factor
        period = old.every_minutes and max(old.every_minutes * factor, CONTROL_TIMESTEP / 60)
        assert new.every_minutes == period
    assert life.scaled(1.0) == life


@given(any_life(), st.data())
def test_a_newborn_lives_one_phase_in_its_world(life, data):
    number = data.draw(st.integers(1, len(life.phases)))
    newborn = life_named(f"{life.name}@{number}", {life.name: life})
    assert newborn.phases == (life.phases[number - 1],) and newborn.worlds == (
        newborn.phases[0].world,
    )
    assert (newborn.task, newborn.wanted) == (life.task, life.wanted)
    for none in ("0", str(len(life.phases) + 1), "x", ""):
        with pytest.raises(KeyError):
            life_named(f"{life.name}@{none}", {life.name: life})


# Data


@given(any_life())
def test_a_life_is_the_same_after_json(life):
    stored = json.loads(json.dumps(dataclasses.asdict(life)))
    assert life_from(stored) == life
    short = {"name": "mine", "task": "spot_finding", "phases": [{}]}
    assert life_from(short) == Life("mine", "mine", "spot_finding", (Phase(),))


@given(poses)
def test_places_may_be_arrays(pose):
    arrays = {"robot": np.array(pose), "spot": np.array(pose[:2])}
    for kind in (Phase, Start):
        assert kind(**arrays) == kind(robot=pose, spot=pose[:2])


GOOD = {"name": "mine", "task": "spot_finding", "phases": [{"minutes": 1}]}
IN_A_PHASE = {
    "a phase has the fields stage, .*, got 'minute'": {"minute": 1},
    "a phase must have names with values, got 3": 3,
    "stage must be 'pre' or 'training' or 'post', got": {"stage": "youth"},
    "minutes must be a number in .*, got 'long'": {"minutes": "long"},
    "every_minutes must be a number in": {"every_minutes": 1e-320},
    "learning must be true or false": {"learning": 1},
    r"robot must be finite real numbers of shape \(3,\)": {"robot": [0, 0]},
    r"spot, unless 'random', must be finite real numbers of .*, got 'middle'": {"spot": "middle"},
    "phase 2: a world has the fields wheels, nose, .*, got 'wheel'": {"world": {"wheel": 1}},
    "rewarded must be 'task' or 'driving', got": {"world": {"rewarded": "sleep"}},
}
WRONG = {
    "a life must have names with values, got 3": 3,
    "a life has the fields name, .*, got 'colour'": GOOD | {"colour": 1},
    "a life must have a list of phases, ": GOOD | {"phases": []},
    "a life must have a name": {"task": "spot_finding", "phases": [{}]},
    "name must be at most 40 lower case letters": GOOD | {"name": "My life"},
    "title must be 1 to 60 characters": GOOD | {"title": ""},
    "phases must be one or more, ordered by stage: pre, training, post": GOOD
    | {"phases": [{"stage": "post"}, {"stage": "pre"}]},
    "both tests must last equally long, got 1 and 2 min": GOOD
    | {"phases": [{"stage": "pre", "minutes": 1}, {"stage": "post", "minutes": 2}]},
    **{words: GOOD | {"phases": [{}, phase]} for words, phase in IN_A_PHASE.items()},
}


@pytest.mark.parametrize("words", WRONG)
def test_what_is_no_life_is_refused_with_one_sentence(words):
    with pytest.raises(ValueError, match=words) as caught:
        life_from(WRONG[words])
    assert "\n" not in str(caught.value)


def test_a_world_as_a_file_has_it_is_refused_in_python():
    with pytest.raises(ValueError, match="world must be a World, got {'nose': 90}"):
        Phase(world={"nose": 90})


# Lives that change


@pytest.mark.parametrize("life", CHANGING, ids=lambda life: life.name)
def test_a_changing_life_lasts_12_hours_and_returns_to_its_worlds(life):
    assert sum(life.steps()) == 12 * 36_000 and len({*life.steps()}) == 1
    assert not life.tested and life.worlds[0] == World()
    assert all(phase.learning and phase.robot is None for phase in life.phases)
    visits = [sum(phase.world == world for phase in life.phases) for world in life.worlds]
    if life.name == "drift":
        turns = np.array([world.wheels for world in life.worlds]).reshape(-1, 2, 2)
        steps = turns[1:] @ turns[:-1].transpose(0, 2, 1)
        assert len(turns) == 120
        np.testing.assert_allclose(np.degrees(np.arccos(steps[:, 0, 0])), 3)
        np.testing.assert_allclose(turns[0], steps[0] @ turns[-1], atol=1e-12)
    else:
        assert min(visits) >= 3


# Placements


class Recorder:
    """Robots that keep what they are given."""

    def __init__(self):
        self.dimensions, self.robots = Dimensions.of(arena_spec().compile()), 2
        self.calls, self.world = [], World()
        for name, what in (("place", "robots"), ("place_spot", "spots")):
            setattr(self, name, lambda *given, what=what: self.calls.append((what, *given)))

    def enter(self, world):
        assert not self.calls
        self.world = world


@given(phases)
def test_a_phase_places_spots_before_robots_and_what_it_does_not_place_stays(phase):
    first, again, other = Recorder(), Recorder(), Recorder()
    for batch, seed in ((first, 0), (again, 0), (other, 1)):
        place(batch, phase, np.random.default_rng(seed))
    assert first.world == phase.world  # entered before anything is placed
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
