"""Intervals against small oracles, and for data that do not determine them."""

import itertools
import math
from statistics import NormalDist

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from musebot.protocols.analysis import intervals
from musebot.protocols.analysis.paper_tables import PAPER
from musebot.protocols.experiment.conditions import Condition
from musebot.protocols.results.learn_ability import Summary

quick = settings(deadline=None, max_examples=30)
NAN = math.nan
Z = 1.959963984540054  # the 97.5th percentile of the normal distribution


def wilson(count, robots):
    """Returns the interval of Wilson (1927)."""
    p = count / robots
    middle = (p + Z**2 / (2 * robots)) / (1 + Z**2 / robots)
    half = Z / (1 + Z**2 / robots) * math.sqrt(p * (1 - p) / robots + Z**2 / (4 * robots**2))
    return middle - half, middle + half


@quick
@given(st.integers(1, 500).flatmap(lambda n: st.tuples(st.integers(0, n), st.just(n))))
def test_the_interval_of_a_share_is_that_of_wilson(pair):
    assert intervals.share(*pair) == pytest.approx(wilson(*pair), abs=1e-9)


def test_a_share_without_robots_is_unknown():
    assert all(map(math.isnan, intervals.share(0, 0)))


def bca_of_mean(values, level=0.95):
    """Returns the BCa interval by its definition, from every resample of a few values."""
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
def test_the_interval_of_a_mean_equals_bca_over_all_resamples(values):
    low, high = intervals.mean(np.array(values))
    expected = bca_of_mean(np.array(values))
    assert (low, high) == pytest.approx(expected, abs=0.05 * np.ptp(values))
    assert low < np.mean(values) < high


def test_a_skewed_sample_has_a_skewed_interval():
    values = np.array([0.0] * 15 + [0.1, 0.2, 0.4, 1.0, 3.0])
    low, high = intervals.mean(values)
    assert high - values.mean() > 1.5 * (values.mean() - low) > 0


def test_intervals_cover_the_true_value_in_about_95_per_cent():
    random = np.random.default_rng(3)
    hits = np.zeros(2)
    for _ in range(200):
        values = random.normal(0.4, 0.7, 40)
        for i, (find, truth) in enumerate([(intervals.mean, 0.4), (intervals.deviation, 0.7)]):
            low, high = find(values)
            hits[i] += low < truth < high
    assert ((hits >= 176) & (hits <= 199)).all(), hits  # 190 +- 3 standard deviations


@pytest.mark.parametrize("find", [intervals.mean, intervals.deviation])
@pytest.mark.parametrize("values", [[], [0.5], [1.0, -1.0], [0.5] * 50])
def test_few_robots_or_equal_values_have_no_interval(find, values, recwarn):
    assert all(map(math.isnan, find(np.array(values))))
    assert not recwarn.list


def test_an_interval_is_reproducible():
    values = np.random.default_rng(0).random(30)
    assert intervals.mean(values) == intervals.mean(values.copy())


def test_the_papers_mean_has_the_interval_of_student():
    column = PAPER[Condition("spot_finding", "fixed")]  # 45 measured robots: t(44) = 2.0154
    half = 2.0153675744 * 0.9681 / math.sqrt(45)
    assert intervals.mean_from(column) == pytest.approx((0.08 - half, 0.08 + half), abs=1e-6)
    nobody = Summary((0, 0, 0, 0, 9), float("nan"), float("nan"), 0.0)
    assert all(map(math.isnan, intervals.mean_from(nobody)))


def test_variation_by_chance_is_smaller_between_larger_groups():
    paper = PAPER[Condition("wall_avoidance", "creative")]
    few = Summary((3, 3, 1, 2, 1), 0, 0, 0)
    many = Summary((300, 300, 100, 200, 100), 0, 0, 0)
    assert intervals.chance_variation(few, paper) > 3 * intervals.chance_variation(many, paper) > 0
    assert math.isnan(intervals.chance_variation(Summary((0, 0, 0, 0, 0), 0, 0, 0), paper))


def test_variation_by_chance_is_that_of_two_samples_of_one_population():
    # Of two categories: |a / n - b / n|, about normal, with variance 2 p (1 - p) / n.
    pair = Summary((250, 0, 0, 250, 0), 0, 0, 0), Summary((250, 0, 0, 250, 0), 0, 0, 0)
    expected = Z * math.sqrt(2 * 0.25 / 500)
    assert intervals.chance_variation(*pair) == pytest.approx(expected, abs=0.004)


def marks(count, robots):
    return np.arange(robots) < count


def test_newcombes_interval_of_independent_shares_equals_his_paper():
    # Statistics in Medicine 17, 873 (1998), table II: 56/70 - 48/80, method 10.
    found = intervals.difference_of_shares(marks(56, 70), marks(48, 80), paired=False)
    assert found == pytest.approx((0.0524, 0.3339), abs=5e-5)


def test_newcombes_interval_of_paired_shares_equals_the_textbook():
    # Altman, Machin, Bryant and Gardner, Statistics with Confidence (2000), table 6.2: 14 pairs
    # with both, 5 with the first alone, 22 with neither; 0.01 to 0.23.
    first, second = marks(19, 41), marks(14, 41)
    found = intervals.difference_of_shares(first, second, paired=True)
    assert found == pytest.approx((0.0115, 0.2265), abs=5e-5)


pairs = st.lists(st.tuples(st.booleans(), st.booleans()), min_size=1, max_size=80).map(np.array)


@quick
@given(pairs)
def test_a_difference_of_shares_lies_in_its_interval_and_swapping_mirrors_it(table):
    first, second = table.T
    for paired in (False, True):
        low, high = intervals.difference_of_shares(first, second, paired)
        assert -1 <= low <= first.mean() - second.mean() + 1e-12
        assert first.mean() - second.mean() - 1e-12 <= high <= 1
        mirror = intervals.difference_of_shares(second, first, paired)
        assert mirror == pytest.approx((-high, -low))


def test_correlated_pairs_narrow_the_interval_of_a_difference_of_shares():
    first, second = marks(30, 60), marks(33, 60)
    (a, b), (c, d) = (intervals.difference_of_shares(first, second, p) for p in (True, False))
    assert d - c > 2 * (b - a) > 0


@pytest.mark.parametrize("paired", [False, True])
def test_intervals_of_differences_cover_the_true_value_in_about_95_per_cent(paired):
    random = np.random.default_rng(5)
    hits = np.zeros(2)
    for _ in range(200):
        common = random.normal(0, 0.6, 60) if paired else 0.0
        first, second = (common + random.normal(mean, 0.6, 60) for mean in (0.5, 0.2))
        low, high = intervals.difference(first, second, np.nanmean, paired)
        hits[0] += low < 0.3 < high
        # Shares above a border, known for normal distributions.
        spread = math.hypot(0.6, 0.6) if paired else 0.6
        p, q = (1 - NormalDist(mean, spread).cdf(0.9) for mean in (0.5, 0.2))
        low, high = intervals.difference_of_shares(first > 0.9, second > 0.9, paired)
        hits[1] += low < p - q < high
    assert ((hits >= 178) & (hits <= 199)).all(), hits  # 190 +- 3 standard deviations


def test_correlated_pairs_narrow_the_interval_of_a_difference_of_means():
    random = np.random.default_rng(6)
    first = random.normal(0, 1, 80)
    second = first + random.normal(0.2, 0.1, 80)
    (a, b), (c, d) = (intervals.difference(first, second, np.nanmean, p) for p in (True, False))
    assert d - c > 5 * (b - a) > 0


@pytest.mark.parametrize(
    "values",
    [[], [1.0, NAN, NAN, NAN, NAN, NAN, 0.5], [*[1.0, 0.0, 0.5, 0.2, -1.0], *[NAN] * 200]],
)
def test_differences_of_few_measured_robots_have_no_interval(values, recwarn):
    many = np.random.default_rng(0).random(len(values))
    found = intervals.difference(np.array(values), many, np.nanmean, paired=True)
    assert all(map(math.isnan, found))
    assert not recwarn.list
