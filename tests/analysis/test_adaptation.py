"""How robots adapt: laws of the measures, on curves whose values are known."""

import dataclasses

import numpy as np
import pytest
from helpers import run_of_rows
from hypothesis import given
from hypothesis import strategies as st

from musebot.protocols.analysis.adaptation import (
    WINDOW,
    Adaptation,
    Bounds,
    minutes_of_phases,
    shares_of,
)
from musebot.protocols.runs.conditions import Condition
from musebot.protocols.runs.run import Robot
from musebot.tasks.lives import BODY, LIVES

UNIT = Bounds(np.zeros(3), np.ones(3))
MINUTES = 60


def curves(*minutes, phases=12, high=1.0):
    """Robots that reach nothing in the first minutes of each phase, then all: one robot each."""
    phase = np.array([np.where(np.arange(MINUTES) < one, 0.0, high) for one in minutes])
    return np.tile(phase, (1, phases))


@given(st.lists(st.integers(0, MINUTES - WINDOW), min_size=1, max_size=4))
def test_recovery_is_the_minutes_until_the_goal_is_reached_half_of_the_time(minutes):
    found = Adaptation.of(curves(*minutes), BODY, UNIT)
    # A window of five minutes is recovered as soon as three of them are.
    wanted = [max(1, one - 1) for one in minutes]
    assert (found.recovery == np.array(wanted)[:, None]).all()
    assert found.online == pytest.approx([1 - one / MINUTES for one in minutes])


@given(st.tuples(*[st.floats(0, 0.4)] * 3), st.tuples(*[st.floats(0.5, 1)] * 3))
def test_scores_are_0_at_the_lower_bound_of_a_world_and_1_at_its_upper(low, high):
    low, high = np.array(low), np.array(high)
    for score in (0, 0.5, 1):
        shares = np.tile((low + score * (high - low)).repeat(MINUTES), (2, 4))
        found = Adaptation.of(shares, BODY, Bounds(low, high))
        assert found.online == pytest.approx([score] * 2)
        assert found.scores == pytest.approx(np.full((2, 12), score))
        assert (found.failed == (score < 0.1)).all()


def test_a_long_phase_counts_more_in_the_score_of_a_life():
    phases = [dataclasses.replace(BODY.phases[k], minutes=10.0 * (k + 1)) for k in range(3)]
    life = dataclasses.replace(BODY, phases=tuple(phases))
    shares = np.array([0.2, 0.4, 1.0]).repeat([10, 20, 30])[None]
    assert Adaptation.of(shares, life, UNIT).online == pytest.approx([(0.2 + 0.8 + 3) / 6])


def test_an_invalid_robot_never_reaches_the_goal():
    kinds = ("", "invalid", "")
    rows = [Robot("body", "creative", 1, 0, i, 0.0, 0.0, 0.5, kind) for i, kind in enumerate(kinds)]
    run, condition = run_of_rows(rows, minutes=3), Condition("body", "creative")
    run.results[condition].curves[:] = 0.5
    assert shares_of(run, condition).tolist() == [[0.5] * 3, [0] * 3, [0.5] * 3]


def test_a_robot_that_never_recovers_takes_the_whole_phase():
    found = Adaptation.of(curves(MINUTES, high=0.0), BODY, UNIT)
    assert (found.recovery == MINUTES).all() and found.failed.all()


def faster(factors):
    """One robot that needs 40 minutes in a phase, times a factor."""
    parts = [curves(round(40 * factor) + 1, phases=1) for factor in factors]
    return Adaptation.of(np.concatenate(parts, axis=1), BODY, UNIT)


def test_an_old_robot_is_compared_with_newborns_of_the_same_world():
    found = faster([1] * 12)
    newborns = [np.array([minutes]) for minutes in (40, 20, 80)]
    assert found.relative_recovery(newborns).tolist() == [2, 0.5, 1] * 3 + [2, 0.5]
    slower = faster([5.0, 0.1, 9.0] + [2 ** (-1 + k / 8) for k in range(9)])  # returns only
    equal = [np.array([40])] * 3
    assert found.slope(equal) == pytest.approx(0)
    assert slower.slope(equal) == pytest.approx(1 / 8, abs=0.02)


def test_the_interval_of_the_last_recovery_covers_both_groups_of_robots():
    random = np.random.default_rng(3)
    covered, means, widths = [], [], []
    for _ in range(40):
        old = Adaptation.of(curves(*random.integers(10, 30, 30)), BODY, UNIT)
        newborns = [old.recovery[:, 0], *random.integers(20, 60, (2, 30)).astype(float)]
        mean, (low, high) = old.last_recovery(newborns, 3)
        assert mean == pytest.approx(old.relative_recovery(newborns)[-3:].mean())
        covered.append(low < (1 + 2 * 18.5 / 39.5) / 3 < high)
        means.append(mean)
        widths.append(high - low)
    assert 34 <= sum(covered)
    assert 0.7 < np.mean(widths) / (2 * 1.96 * np.std(means)) < 1.4
    # In the first world old robots are compared with themselves: resampling makes no width.
    same = old.last_recovery([old.recovery[:, 0]] * 3, 3)[1]
    alone = dataclasses.replace(old, worlds=np.zeros(12, dtype=int))
    assert np.isnan(alone.last_recovery([old.recovery[:, 0]], 3)[1]).all()
    assert same[0] < same[1]
    few = dataclasses.replace(old, recovery=old.recovery[:2])
    assert np.isnan(few.last_recovery([newborns[0][:2]] * 3, 3)[1]).all()


def test_savings_compare_the_last_visits_of_worlds_with_the_first():
    for birth in (1, 20):  # the world of birth is left out
        assert faster([birth] + [1] * 8 + [0.5] * 3).savings() == pytest.approx(0.5)
    assert faster([1] * 12).savings() == pytest.approx(0)
    once = dataclasses.replace(BODY, phases=BODY.phases[:3])
    found = Adaptation.of(curves(10, phases=3), once, UNIT)
    assert np.isnan(found.savings()) and np.isnan(found.forgetting())


def test_forgetting_is_what_is_lost_between_two_visits():
    start, end = np.random.default_rng(4).random((2, 12))
    phases = [np.repeat([one, other], [30, 30]) for one, other in zip(start, end, strict=True)]
    found = Adaptation.of(np.concatenate(phases)[None], BODY, UNIT)
    assert found.forgetting() == pytest.approx((end[:9] - start[3:]).mean())  # three worlds


def test_the_worst_tenth_is_rounded_up():
    found = Adaptation.of(curves(0), BODY, UNIT)
    for robots, mean in ((5, 0), (10, 0), (11, 0.5), (25, 1)):
        online = np.random.default_rng(robots).permutation(robots)
        assert dataclasses.replace(found, online=online).worst_tenth() == mean


@pytest.mark.parametrize("name", LIVES)
def test_each_minute_belongs_to_one_phase_and_each_phase_has_a_minute(name):
    whole = minutes_of_phases(LIVES[name])
    assert [len(own) for own in whole] == [phase.minutes for phase in LIVES[name].phases]
    assert np.concatenate(whole).tolist() == list(range(sum(map(len, whole))))
    for own in minutes_of_phases(rehearsal := LIVES[name].scaled(0.01)):
        assert len(own) and own.max() < len(rehearsal.steps_of_minutes())
