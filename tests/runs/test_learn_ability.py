"""The rows of tables 1 and 2; test_run.py has Learn Ability (Eq. 4)."""

import math
from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from musebot.protocols.runs.learn_ability import (
    Summary,
    category,
    classes,
    summarise,
    total_variation,
)

thorough = settings(max_examples=200)


def test_a_learn_ability_stands_in_its_row():
    for value, name in (
        (1.0, "L = 1"), (np.nextafter(1, 0), "0 < L < 1"), (5e-324, "0 < L < 1"), (0.0, "L = 0"),
        (-0.0, "L = 0"), (-5e-324, "L < 0"), (-1.0, "L < 0"), (float("nan"), "unmeasured"),
    ):  # fmt: skip
        assert category(value) == name


# Summaries


def test_a_column_computed_by_hand():
    abilities = [1.0, 1.0, 0.5, 0.0, -0.5, float("nan")]
    summary = summarise(abilities, [0, 0, 60, 120, 180, 0], test_time=1200, invalid=2)
    assert summary.counts == (2, 1, 1, 1, 1)
    assert summary.robots == 6
    assert summary.mean == pytest.approx(2.0 / 5)
    # Deviations from 0.4: 0.6, 0.6, 0.1, -0.4, -0.9; their squares sum up to 1.7.
    assert summary.deviation == pytest.approx(math.sqrt(1.7 / 4))
    assert summary.post_share == pytest.approx(360 / 6 / 1200)
    assert summary.invalid == 2
    assert summary.shares.tolist() == pytest.approx([2 / 6, 1 / 6, 1 / 6, 1 / 6, 1 / 6])


def test_few_robots_have_no_mean_or_no_deviation_and_no_warning():
    nobody, one, empty = (summarise(x, [30.0] * len(x), 100) for x in ([math.nan], [0.25], []))
    assert math.isnan(nobody.mean) and math.isnan(nobody.deviation) and nobody.post_share == 0.3
    assert one.mean == 0.25 and math.isnan(one.deviation)
    assert empty.robots == 0 and empty.shares.tolist() == [0] * 5 and math.isnan(empty.post_share)


# Total variation

columns = st.tuples(*[st.integers(0, 500)] * 5).filter(any).map(lambda c: Summary(c, 0, 0, 0))


@thorough
@given(columns, columns)
def test_total_variation_is_the_share_of_robots_that_stand_in_another_row(first, second):
    common = sum(
        min(Fraction(a, first.robots), Fraction(b, second.robots))
        for a, b in zip(first.counts, second.counts, strict=True)
    )
    assert total_variation(first, second) == pytest.approx(float(1 - common), abs=1e-12)


@thorough
@given(st.lists(st.one_of(st.floats(-1, 1), st.just(float("nan"))), max_size=20))
def test_classes_are_those_of_l_rounded_to_two_decimals(abilities):
    for ability, kind in zip(abilities, classes(abilities), strict=True):
        if abs(abs(ability) - 0.005) > 1e-9 and abs(ability - 0.995) > 1e-9:  # no tie
            kinds = {abs(ability) < 0.005: "L = 0", ability > 0.995: "L = 1"}
            assert kind == kinds.get(True, category(ability))
    assert classes(abilities, exact=True) == [category(ability) for ability in abilities]


def test_a_summary_rounds_classes_but_not_the_mean():
    near, times = [0.004, -0.004, 0.996], [10, 10, 10]
    rounded, exact = (summarise(near, times, 100, exact=exact) for exact in (False, True))
    assert rounded.counts == (1, 0, 2, 0, 0)
    assert exact.counts == (0, 2, 0, 1, 0)
    assert rounded.mean == exact.mean == pytest.approx(0.332)
