"""Comparisons of two runs' cells: tests that count, and Holm's correction by its definition."""

import itertools
import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from musebot.protocols.analysis.hypothesis_tests import holm, same_share, same_statistic

quick = settings(deadline=None, max_examples=50)
NAN = math.nan
p_values = st.lists(st.floats(0, 1), min_size=1, max_size=6).map(np.array)


def closed(values):
    """Holm's correction as a closed test: the worst Bonferroni of all subsets with a member."""
    return [
        max(
            min(1, len(subset) * min(values[j] for j in subset))
            for size in range(1, len(values) + 1)
            for subset in itertools.combinations(range(len(values)), size)
            if i in subset
        )
        for i in range(len(values))
    ]


@quick
@given(p_values)
def test_holms_correction_is_the_closed_test_of_bonferronis(values):
    assert holm(values) == pytest.approx(closed(values))


@quick
@given(p_values, st.floats(0.001, 0.2))
def test_holm_rejects_step_by_step_until_the_first_that_is_too_large(values, alpha):
    rejected = np.zeros(len(values), dtype=bool)
    for left, index in zip(range(len(values), 0, -1), np.argsort(values), strict=True):
        if values[index] * left >= alpha:
            break
        rejected[index] = True
    assert ((holm(values) < alpha) == rejected).all()


def test_what_could_not_be_tested_counts_as_tested():
    found = holm(np.array([NAN, 0.02, NAN, 0.3]))
    assert found[[1, 3]] == pytest.approx([4 * 0.02, 3 * 0.3])
    assert np.isnan(found[[0, 2]]).all()
    assert holm(np.array([])).shape == (0,)


def test_a_share_in_pairs_is_a_game_of_coins_among_those_that_changed():
    first = np.array([True] * 20 + [True] * 9 + [False] * 1 + [False] * 30)
    second = np.array([True] * 20 + [False] * 9 + [True] * 1 + [False] * 30)
    expected = 2 * sum(math.comb(10, k) for k in (9, 10)) / 2**10
    assert same_share(first, second, paired=True) == pytest.approx(expected)
    assert same_share(first, first, paired=True) == 1


def test_a_share_in_two_groups_is_fishers_count_of_tables():
    first, second = np.arange(10) < 7, np.arange(8) < 1
    ways = [math.comb(8, k) * math.comb(10, 10 - k) / math.comb(18, 10) for k in range(9)]
    extreme = sum(p for p in ways if p <= ways[7] * (1 + 1e-9))
    assert same_share(first, second, paired=False) == pytest.approx(extreme)


def all_swaps(first, second):
    """The share of all swaps of pairs that set the means as far apart as they are."""
    differences = first - second
    apart = [
        abs(np.dot(signs, differences)) for signs in itertools.product((1, -1), repeat=len(first))
    ]
    return np.mean(np.array(apart) >= abs(differences.sum()) - 1e-9)


def test_means_of_pairs_are_judged_by_all_swaps():
    random = np.random.default_rng(2)
    first = random.normal(0.5, 1, 8)
    second = random.normal(0, 1, 8)
    found = same_statistic(first, second, np.nanmean, paired=True, resamples=1000)
    assert found == pytest.approx(all_swaps(first, second))  # 256 of them: none left to chance


def test_means_of_groups_are_judged_by_all_deals():
    first, second = np.array([1.0, 0.9, 0.8, 0.7, 0.9]), np.array([0.1, 0.3, 0.2, 0.75, 0.4])
    pool = np.concatenate([first, second])
    apart = [
        abs(pool[list(chosen)].mean() - np.delete(pool, list(chosen)).mean())
        for chosen in itertools.combinations(range(10), 5)
    ]
    expected = np.mean(np.array(apart) >= abs(first.mean() - second.mean()) - 1e-9)
    found = same_statistic(first, second, np.nanmean, paired=False, resamples=1000)
    assert found == pytest.approx(expected)


def test_one_pair_that_changed_among_many_that_did_not_is_no_difference():
    # Either way round the means are as far apart as they are, but for the last bit.
    first = np.random.default_rng(1).choice([1, -1, 0.2, -0.3, NAN], 100)
    second = first.copy()
    second[np.flatnonzero(first == 0.2)[0]] = 0.21
    for statistic in (np.nanmean, np.nanstd):
        assert same_statistic(first, second, statistic, paired=True, resamples=999) == 1


def test_few_measured_robots_are_not_judged(recwarn):
    first, second = np.array([0.1, 0.2, 0.3, 0.4] + [NAN] * 9), np.linspace(0, 1, 13)
    for paired in (False, True):
        assert math.isnan(same_statistic(first, second, np.nanmean, paired, resamples=99))
    assert not recwarn.list


def test_robots_without_a_value_belong_to_the_lives_that_are_swapped(recwarn):
    # Five measured on either side, in different pairs: chance deals all of them to one side.
    first = np.array([1.0] * 5 + [NAN] * 5)
    second = np.array([NAN] * 5 + [-1.0] * 5)
    found = same_statistic(first, second, np.nanmean, paired=True, resamples=10**4)
    # Means are as far apart where both sides are of one kind each; a side without values counts.
    assert found == pytest.approx(4 / 2**10)
    assert not recwarn.list


@pytest.mark.parametrize("paired", [False, True])
def test_runs_of_one_kind_differ_somewhere_once_in_twenty(paired):
    random = np.random.default_rng(4)
    wrong = 0
    for _ in range(100):
        p = []
        for _ in range(4):
            common = random.normal(0, 1, 30) * paired
            first, second = (common + random.normal(0, 1, 30) for _ in range(2))
            p.append(same_statistic(first, second, np.nanmean, paired, resamples=199))
            p.append(same_share(first > 0.5, second > 0.5, paired))
        wrong += holm(np.array(p)).min() < 0.05
    assert wrong <= 11  # at most 5, give or take three deviations
