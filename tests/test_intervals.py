"""Intervals: small oracles written out by hand, and data that say nothing."""

import itertools
import math
from statistics import NormalDist

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from musebot.protocols import intervals
from musebot.protocols.learn_ability import PAPER, Summary

quick = settings(deadline=None, max_examples=30)
Z = 1.959963984540054  # the 97.5th percentile of the normal distribution


def wilson(count, robots):
    """The interval as Wilson (1927) wrote it."""
    p = count / robots
    middle = (p + Z**2 / (2 * robots)) / (1 + Z**2 / robots)
    half = Z / (1 + Z**2 / robots) * math.sqrt(p * (1 - p) / robots + Z**2 / (4 * robots**2))
    return middle - half, middle + half


@quick
@given(st.integers(1, 500).flatmap(lambda n: st.tuples(st.integers(0, n), st.just(n))))
def test_the_interval_of_a_share_is_wilsons(pair):
    assert intervals.share(*pair) == pytest.approx(wilson(*pair), abs=1e-9)


def test_none_of_no_robots_is_unknown():
    assert all(map(math.isnan, intervals.share(0, 0)))


def bca_of_mean(values, level=0.95):
    """BCa by complete enumeration: every resample of a few values, the definition by hand."""
    normal, n = NormalDist(), len(values)
    means = np.sort([np.mean(s) for s in itertools.product(values, repeat=n)])
    below = (np.sum(means < np.mean(values)) + np.sum(means <= np.mean(values))) / 2 / len(means)
    bias = normal.inv_cdf(below)
    left_out = np.array([np.mean(np.delete(values, i)) for i in range(n)])
    d = left_out.mean() - left_out
    skew = (d**3).sum() / (6 * (d**2).sum() ** 1.5)
    ends = []
    for tail in ((1 - level) / 2, (1 + level) / 2):
        z = bias + normal.inv_cdf(tail)
        ends.append(np.quantile(means, normal.cdf(bias + z / (1 - skew * z))))
    return tuple(ends)


@pytest.mark.parametrize(
    "values", [[0.1, 0.2, 0.35, 0.4, 0.9, 1.7], [-1.0, -0.2, 0.3, 0.31, 0.5, 1.0]]
)
def test_the_interval_of_a_mean_is_that_of_all_resamples_bca(values):
    low, high = intervals.mean(np.array(values))
    expected = bca_of_mean(np.array(values))
    assert (low, high) == pytest.approx(expected, abs=0.05 * np.ptp(values))
    assert low < np.mean(values) < high


def test_a_skewed_sample_has_a_skewed_interval():
    values = np.array([0.0] * 15 + [0.1, 0.2, 0.4, 1.0, 3.0])
    low, high = intervals.mean(values)
    assert high - values.mean() > 1.5 * (values.mean() - low) > 0


def test_intervals_cover_the_truth_about_nineteen_times_in_twenty():
    random = np.random.default_rng(3)
    hits = np.zeros(2)
    for _ in range(200):
        values = random.normal(0.4, 0.7, 40)
        for i, (find, truth) in enumerate([(intervals.mean, 0.4), (intervals.deviation, 0.7)]):
            low, high = find(values)
            hits[i] += low < truth < high
    assert ((hits >= 176) & (hits <= 199)).all(), hits  # 190, give or take three deviations


@pytest.mark.parametrize("find", [intervals.mean, intervals.deviation])
@pytest.mark.parametrize("values", [[], [0.5], [1.0, -1.0], [0.5] * 50])
def test_few_robots_or_all_alike_have_no_interval(find, values, recwarn):
    assert all(map(math.isnan, find(np.array(values))))
    assert not recwarn.list


def test_an_interval_is_the_same_every_time():
    values = np.random.default_rng(0).random(30)
    assert intervals.mean(values) == intervals.mean(values.copy())


def test_the_papers_mean_has_students_interval():
    column = PAPER["spot_finding", "fixed"]  # 45 measured robots: t(44) = 2.0154
    half = 2.0153675744 * 0.9681 / math.sqrt(45)
    assert intervals.mean_from(column) == pytest.approx((0.08 - half, 0.08 + half), abs=1e-6)
    nobody = Summary((0, 0, 0, 0, 9), float("nan"), float("nan"), 0.0)
    assert all(map(math.isnan, intervals.mean_from(nobody)))


def test_chance_explains_less_variation_between_larger_groups():
    paper = PAPER["wall_avoidance", "creative"]
    few = Summary((3, 3, 1, 2, 1), 0, 0, 0)
    many = Summary((300, 300, 100, 200, 100), 0, 0, 0)
    assert intervals.chance_variation(few, paper) > 3 * intervals.chance_variation(many, paper) > 0
    assert math.isnan(intervals.chance_variation(Summary((0, 0, 0, 0, 0), 0, 0, 0), paper))


def test_chance_explains_what_two_samples_of_one_kind_are_apart():
    # Two rows: the distance is |a / n - b / n|, about normal, with variance 2 p (1 - p) / n.
    pair = Summary((250, 0, 0, 250, 0), 0, 0, 0), Summary((250, 0, 0, 250, 0), 0, 0, 0)
    expected = Z * math.sqrt(2 * 0.25 / 500)
    assert intervals.chance_variation(*pair) == pytest.approx(expected, abs=0.004)
