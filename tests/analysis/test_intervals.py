"""Intervals against small oracles, and for data that do not determine them."""

import json
import math
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import stats

from musebot.protocols.analysis import intervals
from musebot.protocols.analysis.intervals import ABILITY, SHARE
from musebot.protocols.analysis.paper_tables import PAPER
from musebot.protocols.runs.conditions import Condition
from musebot.protocols.runs.learn_ability import Summary

NAN = math.nan
Z = 1.959963984540054  # the 97.5th percentile of the normal distribution


def wilson(count, robots):
    """Returns the interval of Wilson (1927)."""
    p = count / robots
    middle = (p + Z**2 / (2 * robots)) / (1 + Z**2 / robots)
    half = Z / (1 + Z**2 / robots) * math.sqrt(p * (1 - p) / robots + Z**2 / (4 * robots**2))
    return middle - half, middle + half


@given(st.integers(1, 500).flatmap(lambda n: st.tuples(st.integers(0, n), st.just(n))))
def test_the_interval_of_a_share_is_that_of_wilson(pair):
    assert intervals.share(*pair) == pytest.approx(wilson(*pair), abs=1e-9)
    assert all(map(math.isnan, intervals.share(0, 0)))


def test_the_interval_of_a_mean_is_scipys_bca_bootstrap():
    values = np.random.default_rng(0).gamma(1.0, size=30)  # skewed: other methods differ
    expected = stats.bootstrap((values,), np.mean, method="BCa", n_resamples=20_000, rng=2)
    ends = tuple(expected.confidence_interval)
    assert intervals.mean(values) == pytest.approx(ends, abs=0.04 * np.ptp(ends))


def test_intervals_of_deviations_cover_the_true_value_in_about_95_per_cent():
    random = np.random.default_rng(3)
    found = np.array([intervals.deviation(random.normal(0.4, 0.7, 40)) for _ in range(200)])
    assert 176 <= ((found[:, 0] < 0.7) & (found[:, 1] > 0.7)).sum() <= 199  # 190 +- 3 deviations


def test_few_robots_or_equal_values_have_no_interval(recwarn):
    for values in ([], [0.5], [1.0, -1.0], [0.5] * 50):
        for find in (intervals.mean, intervals.deviation):
            assert all(map(math.isnan, find(np.array(values))))
    assert not recwarn.list


# Values of robots of runs at 9e668f6 after training: share of the time, or L.
_KEPT = json.loads(Path(__file__).with_name("populations.json").read_text())
POPULATIONS = {name: np.array(values) for name, values in _KEPT.items()}


# Samples of a simulation of coverage, by day and at night.
many = pytest.mark.parametrize("samples", [100, pytest.param(1000, marks=pytest.mark.night)])


def share_of_hits(true, ends):
    """Returns what share of intervals contains the true value, and their mean width."""
    low, high = np.array(ends).T
    share, width = ((low <= true) & (true <= high)).mean(), (high - low).mean()
    print(f"{len(ends)} samples: covered {share:.3f}, mean width {width:.4f}")
    return share, width


@many
def test_intervals_of_means_near_an_end_cover_the_true_mean(samples):
    for name, span, robots, widest in (
        # Rare contact; BCa covers 0.79, 0.69, 0.63, 0.74.
        ("steady, contact", SHARE, 200, 0.03),
        ("steady, contact", SHARE, 60, 0.08),
        ("half-steady, contact", SHARE, 60, 0.08),
        ("without persistent_exploration, contact", SHARE, 60, 0.08),
        # Time in the spot where few robots fail; BCa covers 0.65 and 0.86.
        ("continual-steady, in the spot", SHARE, 60, 0.1),
        ("60 steady, in the spot", SHARE, 60, 0.13),
        # L where few robots touch a wall; BCa covers 0.48.
        ("steady, L among walls", ABILITY, 60, 0.22),
    ):
        own, random = POPULATIONS[name], np.random.default_rng(7)
        drawn = (random.choice(own, robots) for _ in range(samples))
        found, width = share_of_hits(own.mean(), [intervals.mean(one, span) for one in drawn])
        assert found >= 0.92 and width < widest, name


@many
@pytest.mark.parametrize("paired", [False, True])
def test_intervals_of_differences_of_rare_contact_cover_the_true_difference(paired, samples):
    for other in ("persistent_exploration", "advantage"):
        one, two = POPULATIONS["60 steady, contact"], POPULATIONS[f"without {other}, contact"]
        rows = np.random.default_rng(8).integers(0, 60, (samples, 2, 60))
        rows[:, 1] = rows[:, 0] if paired else rows[:, 1]
        ends = [
            intervals.difference_of_means(one[first], two[second], paired, SHARE)
            for first, second in rows
        ]
        found, width = share_of_hits(one.mean() - two.mean(), ends)
        assert found >= 0.92 and width < 0.15, other


def test_gaffkes_bounds_of_zeros_and_ones_are_those_of_clopper_and_pearson():
    for count, robots in ((0, 200), (1, 60), (4, 200), (57, 60), (60, 60), (3, 5)):
        found = intervals.mean(marks(count, robots).astype(float), SHARE)
        exact = stats.binomtest(count, robots).proportion_ci(0.95, method="exact")
        assert found == pytest.approx(tuple(exact), abs=0.04 * (exact.high - exact.low))


def test_a_mean_is_near_an_end_below_five_robots_worth_of_distance():
    for count, changed in ((4, True), (6, False), (54, False), (56, True)):
        values = marks(count, 60).astype(float)
        assert (intervals.mean(values, SHARE) != intervals.mean(values)) == changed
        scaled = intervals.mean(2 * values - 1, ABILITY), intervals.mean(2 * values - 1)
        assert (scaled[0] != scaled[1]) == changed
    five = marks(5, 50).astype(float)
    assert intervals.mean(five, SHARE) == intervals.mean(five)


def test_a_difference_is_that_of_groups_if_one_mean_is_near_an_end():
    random = np.random.default_rng(9)
    usual, rare = random.random(60), np.append(np.zeros(58), [0.1, 0.2])
    far = intervals.difference(usual, usual[::-1], np.nanmean, paired=True)
    assert intervals.difference_of_means(usual, usual[::-1], True, SHARE) == far
    (a, b), (c, d) = (intervals.mean(values, SHARE) for values in (usual, rare))
    one, two = usual.mean(), rare.mean()
    ends = one - two - math.hypot(one - a, d - two), one - two + math.hypot(b - one, two - c)
    found = intervals.difference_of_means(np.append(usual, NAN), np.append(NAN, rare), False, SHARE)
    assert found == pytest.approx(ends, abs=1e-12)
    assert intervals.difference_of_means(usual, rare, True, SHARE) == found
    few = np.append(np.zeros(4), np.full(56, NAN))
    assert all(map(math.isnan, intervals.difference_of_means(few, rare, True, SHARE)))


def test_the_papers_mean_has_the_interval_of_student():
    column = PAPER[Condition("spot_finding", "fixed")]  # 45 measured robots: t(44) = 2.0154
    half = 2.0153675744 * 0.9681 / math.sqrt(45)
    assert intervals.mean_from(column) == pytest.approx((0.08 - half, 0.08 + half), abs=1e-6)


def test_variation_by_chance_is_that_of_two_samples_of_one_population():
    # Of two categories: |a / n - b / n|, about normal, with variance 2 p (1 - p) / n.
    half = Summary((250, 0, 0, 250, 0), 0, 0, 0)
    expected = Z * math.sqrt(2 * 0.25 / 500)
    assert intervals.chance_variation(half, half) == pytest.approx(expected, abs=0.004)


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


@given(pairs)
def test_a_difference_of_shares_lies_in_its_interval_and_swapping_mirrors_it(table):
    first, second = table.T
    for paired in (False, True):
        low, high = intervals.difference_of_shares(first, second, paired)
        assert -1 <= low <= first.mean() - second.mean() + 1e-12
        assert first.mean() - second.mean() - 1e-12 <= high <= 1
        mirror = intervals.difference_of_shares(second, first, paired)
        assert mirror == pytest.approx((-high, -low))


def test_equal_values_or_few_robots_leave_a_difference_unknown(recwarn):
    equal, many = np.full(20, 0.5), np.random.default_rng(0).random(205)
    for values in (np.zeros(20), np.append(np.zeros(19), 0.01), np.full(20, 0.3)):
        for pair in ((values, equal), (equal, values)):
            assert all(map(math.isnan, intervals.difference_of_means(*pair, False, SHARE)))
    for values in ([], [1.0, *[NAN] * 5, 0.5], [*[1.0, 0.0, 0.5, 0.2, -1.0], *[NAN] * 200]):
        own = np.array(values, dtype=float)
        found = intervals.difference(own, many[: len(own)], np.nanmean, paired=True)
        assert all(map(math.isnan, found))
    assert not recwarn.list
