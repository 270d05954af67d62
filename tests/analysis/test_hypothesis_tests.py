"""Hypothesis tests against small oracles, and Holm's correction against its definition."""

import itertools
import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import stats

from musebot.protocols.analysis import hypothesis_tests
from musebot.protocols.analysis.hypothesis_tests import (
    Share,
    holm,
    same_classes,
    same_deviation,
    same_mean,
    same_share,
)

NAN = math.nan
p_values = st.lists(st.floats(0, 1), min_size=1, max_size=6).map(np.array)


def closed(values):
    """Returns Holm's correction as a closed test: the largest Bonferroni value of all subsets."""
    return [
        max(
            min(1, len(subset) * min(values[j] for j in subset))
            for size in range(1, len(values) + 1)
            for subset in itertools.combinations(range(len(values)), size)
            if i in subset
        )
        for i in range(len(values))
    ]


@given(p_values)
def test_holms_correction_equals_the_closed_test(values):
    assert holm(values) == pytest.approx(closed(values))


def test_an_impossible_test_counts_as_a_member_of_the_family():
    found = holm(np.array([NAN, 0.02, NAN, 0.3]))
    assert found[[1, 3]] == pytest.approx([4 * 0.02, 3 * 0.3])
    assert np.isnan(found[[0, 2]]).all()
    assert holm(np.array([])).shape == (0,)


def test_paired_shares_are_a_binomial_test_of_the_changed_pairs():
    first = np.array([True] * 20 + [True] * 9 + [False] * 1 + [False] * 30)
    second = np.array([True] * 20 + [False] * 9 + [True] * 1 + [False] * 30)
    expected = 2 * sum(math.comb(10, k) for k in (9, 10)) / 2**10
    assert same_share(first, second, paired=True) == pytest.approx(expected)
    assert same_share(first, first, paired=True) == 1


def test_shares_of_two_groups_are_fishers_exact_test():
    first, second = np.arange(10) < 7, np.arange(8) < 1
    ways = [math.comb(8, k) * math.comb(10, 10 - k) / math.comb(18, 10) for k in range(9)]
    extreme = sum(p for p in ways if p <= ways[7] * (1 + 1e-9))
    assert same_share(first, second, paired=False) == pytest.approx(extreme)
    assert np.isnan(same_share(first, second[:0], paired=False))


def studentized(first, second):
    """Returns the difference of two means in Welch's standard errors."""
    error = np.hypot(*(np.std(x, ddof=1) / len(x) ** 0.5 for x in (first, second)))
    return abs(first.mean() - second.mean()) / error


def test_paired_means_are_tested_by_all_swaps():
    random = np.random.default_rng(2)
    first = random.normal(0.5, 1, 8)
    second = random.normal(0, 1, 8)
    differences = first - second
    apart = [abs(np.dot(signs, differences)) for signs in itertools.product((1, -1), repeat=8)]
    expected = np.mean(np.array(apart) >= abs(differences.sum()) - 1e-9)
    assert same_mean(first, second, paired=True) == pytest.approx(expected, rel=0.1)


def test_means_of_groups_are_tested_by_all_partitions():
    first = np.array([1.0, 0.9, 0.8, 0.4, 0.9])
    second = np.array([0.1, 0.3, 0.2, 0.75, 0.4, 0.95, 0.5])
    pool = np.concatenate([first, second])
    apart = [
        studentized(pool[list(chosen)], np.delete(pool, list(chosen)))
        for chosen in itertools.combinations(range(12), 5)
    ]
    expected = np.mean(np.array(apart) >= studentized(first, second) - 1e-9)
    assert 0.02 < expected < 0.2
    assert same_mean(first, second, paired=False) == pytest.approx(expected, rel=0.1)


@pytest.mark.parametrize(
    ("test", "sizes"), [(same_mean, (15, 60)), (same_mean, (60, 15)), (same_deviation, (60, 15))]
)
def test_groups_of_different_size_and_spread_are_found_to_differ_in_5_per_cent(
    test, sizes, monkeypatch
):
    monkeypatch.setattr(hypothesis_tests, "_DRAWS", 1000)
    random = np.random.default_rng(5)
    wrong = plain = 0
    for _ in range(200):
        first, second = random.normal(0, 3, sizes[0]), random.normal(0, 1, sizes[1])
        if test is same_deviation:  # the means differ, the deviations do not
            first, second = first / 3, second + 9
        wrong += test(first, second, paired=False) < 0.05
        plain += stats.ttest_ind(first, second, equal_var=True).pvalue < 0.05
    assert wrong <= 24  # 10, give or take: the test of deviations is exact for many robots only
    if test is same_mean and sizes == (15, 60):
        assert plain > 40  # a test that assumes equal spread would fail here


def test_one_changed_pair_is_no_difference():
    # Both orders have the same difference but for rounding.
    first = np.random.default_rng(1).choice([1, -1, 0.2, -0.3], 100)
    second = first.copy()
    second[np.flatnonzero(first == 0.2)[0]] = 0.21
    assert same_mean(first, second, paired=True) == 1


def test_few_robots_are_not_tested(recwarn):
    more = np.linspace(0, 1, 13)
    for few, test in itertools.product([more[:0], more[:4]], [same_mean, same_deviation]):
        for groups in ((few, few, True), (few, more, False), (more, few, False)):
            assert math.isnan(test(*groups))
    assert 0 < same_mean(more[:5], more, paired=False) < 1
    assert not recwarn.list


# ---- Inequalities ----


def hypergeometric_tail(a, n, b, m):
    """Returns P(at least a of the a + b marked robots are among the first n), by counting."""
    marked, robots = a + b, n + m
    ways = [
        math.comb(marked, k) * math.comb(robots - marked, n - k) for k in range(min(marked, n) + 1)
    ]
    return sum(ways[a:]) / math.comb(robots, n)


@given(*[st.integers(1, 9).flatmap(lambda n: st.tuples(st.integers(0, n), st.just(n)))] * 2)
def test_fishers_p_values_equal_counted_tables(first, second):
    (a, n), (b, m) = first, second
    found = hypothesis_tests.larger_share(Share(a, n), Share(b, m), "")
    assert found.p_for == pytest.approx(hypergeometric_tail(a, n, b, m))
    assert found.p_against == pytest.approx(hypergeometric_tail(b, m, a, n))


def test_other_shares_are_binomial_tails():
    def tail(p, *counts, of=10):
        return pytest.approx(sum(math.comb(of, k) * p**k * (1 - p) ** (of - k) for k in counts))

    found = hypothesis_tests.majority(Share(8, 10), "")
    assert found.p_for == tail(0.5, 8, 9, 10) and found.p_against == tail(0.5, *range(9))
    twice = hypothesis_tests.larger_share(Share(9, 100), Share(1, 100), "", times=2)
    assert twice.p_for == tail(2 / 3, 9, 10)


@given(st.floats(-2, 2), st.lists(st.integers(-9, 9), min_size=5, max_size=9))
def test_a_larger_mean_is_welchs_t_test(margin, values):
    first, second = np.array(values, dtype=float), np.array([27, 22, 20.8, 23.4, 23.4, 9])
    samples = (hypothesis_tests.Sample.of(values) for values in (first, np.append(second, NAN)))
    found = hypothesis_tests.larger_mean(*samples, "", margin)
    for p, side in ((found.p_for, "greater"), (found.p_against, "less")):
        expected = stats.ttest_ind(first - margin, second, equal_var=False, alternative=side)
        assert p == pytest.approx(expected.pvalue, abs=1e-9)


def test_the_p_value_of_signed_ranks_counts_signs():
    first = np.array([5.0, 4.0, 3.0, 2.0, 1.0, 7.0])
    found = hypothesis_tests.larger_in_pairs(first, np.zeros(6), "")
    assert found.p_for == pytest.approx(1 / 2**6)  # all six positive: one way of 64
    assert found.p_against == pytest.approx(1.0)


def test_signed_ranks_of_equal_differences_are_equal_however_they_are_rounded():
    first, second = np.random.default_rng(1).integers(0, 9, (2, 30)).astype(float)
    found = [hypothesis_tests.larger_in_pairs(first / n, second / n, "") for n in (64, 120)]
    assert found[0] == found[1]


def test_the_joint_test_of_one_pair_with_large_counts_is_the_chi_square_test():
    first, second = (220, 180, 100), (190, 190, 120)
    expected = float(stats.chi2_contingency([first, second]).pvalue)
    assert same_classes([(first, second)]) == pytest.approx(expected, abs=0.015)


def test_the_joint_test_sees_what_each_pair_alone_does_not():
    pair = (260, 240), (230, 270)
    alone, together = same_classes([pair]), same_classes([pair] * 6)
    assert alone > 0.04
    assert together < 0.01
    assert same_classes([((50, 50), (50, 50))]) == 1
