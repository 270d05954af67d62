"""Hypothesis tests of inequalities and of equality, computed by SciPy, and Holm's correction."""

from __future__ import annotations

import dataclasses
import math
import warnings
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np
from scipy import stats

from .intervals import FEWEST, LEVEL, UNKNOWN, Interval

_NO_SCATTER = 1e-12  # rounding: the computed standard deviation of equal values may not be 0
_SEED = 1  # equal data give bit-exact equal p-values
_JOINT_DRAWS = 9999


class Sample(NamedTuple):
    """Summary of a group for a test of means: mean, standard deviation and number of values."""

    mean: float
    deviation: float
    size: int


@dataclasses.dataclass(frozen=True)
class TestedInequality:
    """An inequality that a claim needs, tested in both directions.

    Attributes:
      words: Description of the comparison in words, with its numbers.
      test: Name of the test.
      p_for: One-sided p-value under the null hypothesis that the inequality is false. Small values
        support the inequality. NaN where the data do not allow the test.
      p_against: One-sided p-value under the null hypothesis that the inequality is true. Small
        values contradict the inequality. NaN where the data do not allow the test.
    """

    words: str
    test: str
    p_for: float
    p_against: float


def larger_share(
    first: tuple[int, int], second: tuple[int, int], words: str, times: float = 1
) -> TestedInequality:
    """Tests whether the first share is larger than `times` the second.

    With `times` = 1 this is Fisher's exact test. Otherwise the first count is tested as binomial,
    given the number of robots with the property in both groups. The test is exact for small shares
    and conservative for large ones, because their count scatters less.

    Args:
      first: Counts in the first group: robots with the property, and all robots.
      second: Counts in the second group: robots with the property, and all robots.
      words: Description of the comparison in words, with its numbers.
      times: Factor by which the second share is multiplied before the comparison.
    """
    (a, n), (b, m) = first, second
    if times == 1:
        table = [[a, n - a], [b, m - b]]
        return _both_ways(
            words, "Fisher's exact test", lambda side: stats.fisher_exact(table, alternative=side)
        )
    if a + b == 0:
        return _untested(words, "Conditional binomial test")
    border = times * n / (times * n + m)
    return _both_ways(
        words,
        "Conditional binomial test",
        lambda side: stats.binomtest(a, a + b, border, alternative=side),
    )


def majority(count: int, robots: int, words: str, border: float = 0.5) -> TestedInequality:
    """Tests whether a share is larger than a border.

    Args:
      count: Number of robots with the property.
      robots: Number of all robots.
      words: Description of the comparison in words, with its numbers.
      border: Share in [0, 1] to exceed.
    """
    return _both_ways(
        words,
        "Binomial test",
        lambda side: stats.binomtest(count, robots, border, alternative=side),
    )


def larger_mean(first: Sample, second: Sample, words: str, margin: float = 0.0) -> TestedInequality:
    """Tests by Welch's t test whether the first mean exceeds the second by more than a margin.

    Args:
      first: First group.
      second: Second group.
      words: Description of the comparison in words, with its numbers.
      margin: The first mean must exceed the second by more than this; may be negative.
    """
    if (fewest := min(first.size, second.size)) < FEWEST:
        return _untested(f"{words}: {fewest} measured robots are too few", "Welch's t test")
    if max(first.deviation, second.deviation) < _NO_SCATTER:
        return _untested(f"{words}: all values are equal", "Welch's t test")
    pair = (first.mean - margin, *first[1:], *second)
    return _both_ways(
        words,
        "Welch's t test",
        lambda side: stats.ttest_ind_from_stats(*pair, equal_var=False, alternative=side),
    )


def larger_in_pairs(first: np.ndarray, second: np.ndarray, words: str) -> TestedInequality:
    """Tests by Wilcoxon's signed-rank test whether the first value of each robot is larger.

    Args:
      first: First value of each robot, shape (n,).
      second: Second value of each robot, shape (n,).
      words: Description of the comparison in words, with its numbers.
    """
    differences = first - second
    differences = differences[differences != 0]
    if len(differences) < FEWEST:
        return _untested(f"{words}: too few robots", "Wilcoxon's signed-rank test")
    return _both_ways(
        words,
        "Wilcoxon's signed-rank test",
        lambda side: stats.wilcoxon(differences, alternative=side),
    )


def same_share(first: np.ndarray, second: np.ndarray, paired: bool) -> float:
    """Returns the two-sided p-value under the null hypothesis of equal shares.

    Pairs are tested by McNemar's exact test, independent groups by Fisher's exact test. Both are
    exact forms of a permutation test of shares.

    Args:
      first: Whether each robot of the first group has the property, shape (n,).
      second: Whether each robot of the second group has the property, shape (m,).
      paired: Whether robots of the same index are pairs; then n = m.
    """
    if paired:
        only_first, only_second = int((first & ~second).sum()), int((second & ~first).sum())
        changed = only_first + only_second
        return float(stats.binomtest(only_first, changed).pvalue) if changed else 1.0
    table = [[int(x.sum()), int((~x).sum())] for x in (first, second)]
    found: Any = stats.fisher_exact(table)
    return float(found.pvalue)


def same_classes(pairs: Sequence[tuple[Sequence[int], Sequence[int]]]) -> float:
    """Returns the p-value of a joint test that each pair of groups has equal shares of classes.

    The statistic is the sum of the pairs' chi-squares of homogeneity. Its null distribution is
    simulated: both groups of a pair are drawn from their pooled shares. Small counts need this.

    Args:
      pairs: Number of robots in each class in the first and in the second group.

    Returns:
      The p-value; NaN where there is no pair or a group has no robots.
    """
    if not pairs or any(not sum(group) for pair in pairs for group in pair):
        return float("nan")
    random = np.random.default_rng(_SEED)
    found, drawn = 0.0, np.zeros(_JOINT_DRAWS)
    for pair in pairs:
        sizes = [sum(group) for group in pair]
        shares = np.sum(pair, axis=0) / sum(sizes)
        groups = np.stack([random.multinomial(n, shares, _JOINT_DRAWS) for n in sizes], axis=1)
        found += float(_homogeneity(np.array([pair]))[0])
        drawn += _homogeneity(groups)
    return float((1 + (drawn >= found - 1e-9).sum()) / (1 + _JOINT_DRAWS))


def _homogeneity(counts: np.ndarray) -> np.ndarray:
    """Returns the chi-square of tables of counts, shape (tables, 2, classes)."""
    total = counts.sum(axis=(1, 2), keepdims=True)
    expected = counts.sum(axis=1, keepdims=True) * counts.sum(axis=2, keepdims=True) / total
    terms = np.divide(
        (counts - expected) ** 2, expected, out=np.zeros(expected.shape), where=expected > 0
    )
    return terms.sum(axis=(1, 2))


def same_statistic(
    first: np.ndarray,
    second: np.ndarray,
    statistic: Callable[..., np.ndarray],
    paired: bool,
    resamples: int,
) -> float:
    """Returns the two-sided p-value of a permutation test of two groups' statistics.

    Pairs are swapped at random; robots of independent groups are dealt to the two groups at random.

    Args:
      first: Values of the first group, shape (n,); NaN for a robot without a value.
      second: Values of the second group, shape (m,); NaN for a robot without a value.
      statistic: NumPy function that ignores NaN and has an argument `axis`, such as
        `numpy.nanmean`.
      paired: Whether robots of the same index are pairs; then n = m.
      resamples: Number of permutations; the p-value is at least 1 / (resamples + 1).

    Returns:
      The p-value; NaN where a group has fewer than `FEWEST` values.
    """
    if min((~np.isnan(x)).sum() for x in (first, second)) < FEWEST:
        return float("nan")

    def apart(first: np.ndarray, second: np.ndarray, axis: int) -> np.ndarray:
        distance = np.abs(statistic(first, axis=axis) - statistic(second, axis=axis))
        # Rounded, so that permutations equal to the data but for rounding errors count as equal.
        # Infinite where a group is left without values, which errs towards no difference.
        return np.where(np.isnan(distance), np.inf, np.round(distance, 9))

    with warnings.catch_warnings(), np.errstate(all="ignore"):
        warnings.simplefilter("ignore")
        found = stats.permutation_test(
            (first, second),
            apart,
            permutation_type="samples" if paired else "independent",
            n_resamples=resamples,
            batch=1000,
            alternative="greater",
            rng=np.random.default_rng(_SEED),
        )
    return float(found.pvalue)


def same_draws(first: np.ndarray, second: np.ndarray) -> float:
    """Returns the two-sided p-value of a bootstrap test that two groups' statistics are equal.

    p is the smallest level at which the percentile interval of the difference excludes 0. Unlike a
    permutation test it does not need groups whose values are spread alike.

    Args:
      first: Bootstrap draws of the first group's statistic, shape (R,).
      second: Draws of the second group's statistic, shape (R,). Draws with the same index share
        what both statistics depend on, such as the bounds of a score.

    Returns:
      The p-value, at least 2 / (R + 1); NaN where a draw is NaN.
    """
    apart = np.round(first - second, 9)  # else rounding errors would make equal draws differ
    if np.isnan(apart).any():
        return float("nan")
    fewer = min((apart <= 0).sum(), (apart >= 0).sum())
    return min(1.0, 2 * (int(fewer) + 1) / (len(apart) + 1))


def linear_contrast(
    groups: Sequence[np.ndarray], weights: Sequence[float]
) -> tuple[float, Interval, float]:
    """Returns a weighted sum of the groups' means, its 95 % interval, and its p-value.

    Standard error and degrees of freedom are Welch's and Satterthwaite's (Biometrics Bulletin 2,
    1946): the groups are independent and may have different variances.

    Args:
      groups: Values of each group, none of them NaN.
      weights: Weight of each group's mean.

    Returns:
      The sum, its interval, and the two-sided p-value under the null hypothesis that the sum of the
      true means is 0. Interval and p-value are unknown where a group has fewer than `FEWEST` values
      or no group scatters.
    """
    if any(len(group) < 1 for group in groups):
        return float("nan"), UNKNOWN, float("nan")
    value = sum(w * float(group.mean()) for w, group in zip(weights, groups, strict=True))
    if any(len(group) < FEWEST for group in groups):
        return value, UNKNOWN, float("nan")
    sizes = np.array([len(group) for group in groups])
    parts = np.array(weights) ** 2 * [group.var(ddof=1) for group in groups] / sizes
    if not (error := math.sqrt(parts.sum())) > _NO_SCATTER:
        return value, UNKNOWN, float("nan")
    freedom = parts.sum() ** 2 / (parts**2 / (sizes - 1)).sum()
    low, high = stats.t.interval(LEVEL, freedom, loc=value, scale=error)
    return value, (float(low), float(high)), float(2 * stats.t.sf(abs(value) / error, freedom))


def holm(p_values: np.ndarray) -> np.ndarray:
    """Returns the p-values of a family after Holm's step-down correction.

    The k-th smallest of m p-values is multiplied by m - k + 1, and none becomes smaller than the
    one before it (Scandinavian Journal of Statistics 6, 1979). If hypotheses with a corrected
    p-value below alpha are rejected, the probability of rejecting any true one is at most alpha.

    Args:
      p_values: Uncorrected p-values, shape (m,); NaN for a test that the data do not allow, which
        counts as a member of the family.

    Returns:
      Corrected p-values, shape (m,); NaN stays NaN.
    """
    p_values = np.asarray(p_values, dtype=float)
    order = np.argsort(p_values)  # NaN last
    steps = p_values[order] * np.arange(len(p_values), 0, -1)
    corrected = np.empty_like(p_values)
    corrected[order] = np.minimum(np.maximum.accumulate(steps), 1)
    return corrected


def _both_ways(words: str, name: str, test: Callable[[str], Any]) -> TestedInequality:
    greater, less = (float(test(side).pvalue) for side in ("greater", "less"))
    return TestedInequality(words, name, greater, less)


def _untested(words: str, name: str) -> TestedInequality:
    return TestedInequality(words, name, float("nan"), float("nan"))
