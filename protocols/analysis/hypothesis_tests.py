"""Hypothesis tests of inequalities and of equality, computed by SciPy, and Holm's correction."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np
from scipy import stats

from .intervals import FEWEST_RESAMPLED

ALPHA = 0.05
"""Level of all tests: p-values below it, corrected if there are several, are significant."""

_NO_SCATTER = 1e-12  # rounding: the computed standard deviation of equal values may not be 0
_SEED = 1  # equal data give bit-exact equal p-values
_JOINT_DRAWS = 9999
_DRAWS = 100_000  # of permutations, at most; a multiple of `_BLOCK`
_BLOCK, _ENOUGH_EXTREME = 2_000, 2_000  # of permutations; see `same_mean`


class Share(NamedTuple):
    """Number of robots that have a property, and of all robots of their group."""

    count: int
    robots: int

    @classmethod
    def of(cls, marks: np.ndarray) -> Share:
        """Returns the share of marked robots, given a Boolean for each robot, shape (n,)."""
        return cls(int(marks.sum()), len(marks))

    def __str__(self) -> str:
        """Returns both numbers in words, such as "3 of 50"."""
        return f"{self.count} of {self.robots}"


class Sample(NamedTuple):
    """Summary of a group for a test of means: mean, standard deviation and number of values."""

    mean: float
    deviation: float
    size: int

    @classmethod
    def of(cls, values: np.ndarray) -> Sample:
        """Returns the summary of the values that are not NaN; one value has the deviation 0."""
        measured = values[~np.isnan(values)]
        if not (size := len(measured)):
            return cls(float("nan"), float("nan"), 0)
        return cls(float(measured.mean()), float(measured.std(ddof=min(1, size - 1))), size)

    def __str__(self) -> str:
        """Returns the mean as text; "none" without values."""
        return f"{self.mean:.3f}" if self.size else "none"


@dataclasses.dataclass(frozen=True)
class TestedInequality:
    """An inequality that a claim needs, tested in both directions.

    The p-values are one-sided, and NaN where the data do not allow the test.
    """

    words: str  # description of the comparison, with its numbers
    test: str  # name of the test
    p_for: float  # under the null hypothesis that the inequality is false: a small one supports it
    p_against: float  # under the null hypothesis that it is true: a small one contradicts it


def larger_share(first: Share, second: Share, words: str, times: float = 1) -> TestedInequality:
    """Tests whether the first share is larger than `times` the second.

    With `times` = 1, this is Fisher's exact test. Otherwise the first count is tested as binomial,
    given the sum of both groups' counts. The test is exact for small shares and conservative for
    large ones, because counts of large shares scatter less.
    """
    (a, n), (b, m) = first, second
    if times == 1:
        table = [[a, n - a], [b, m - b]]
        return _both_ways(words, "Fisher's exact test", stats.fisher_exact, table)
    name = "Conditional binomial test"
    if a + b == 0:
        return _untested(words, name)
    return _both_ways(words, name, stats.binomtest, a, a + b, times * n / (times * n + m))


def majority(share: Share, words: str, border: float = 0.5) -> TestedInequality:
    """Tests whether a share is larger than a border in [0, 1]."""
    return _both_ways(words, "Binomial test", stats.binomtest, *share, border)


def larger_mean(first: Sample, second: Sample, words: str, margin: float = 0.0) -> TestedInequality:
    """Tests by Welch's t test whether the first mean exceeds the second by more than a margin.

    The margin may be negative.
    """
    name = "Welch's t test"
    if (fewest := min(first.size, second.size)) < FEWEST_RESAMPLED:
        return _untested(f"{words}: {fewest} measured robots are too few", name)
    if max(first.deviation, second.deviation) < _NO_SCATTER:
        return _untested(f"{words}: all values are equal", name)
    numbers = first.mean - margin, *first[1:], *second
    return _both_ways(words, name, stats.ttest_ind_from_stats, *numbers, False)


def larger_in_pairs(first: np.ndarray, second: np.ndarray, words: str) -> TestedInequality:
    """Tests by Wilcoxon's signed-rank test whether n robots' first values exceed their second."""
    # Rounded, because equal differences of floats may differ in their last digit.
    name, differences = "Wilcoxon's signed-rank test", np.round(first - second, 9)
    differences = differences[differences != 0]
    if len(differences) < FEWEST_RESAMPLED:
        return _untested(f"{words}: too few robots", name)
    return _both_ways(words, name, stats.wilcoxon, differences)


def _both_ways(words: str, name: str, test: Callable[..., Any], *data: Any) -> TestedInequality:
    greater, less = (float(test(*data, alternative=side).pvalue) for side in ("greater", "less"))
    return TestedInequality(words, name, greater, less)


def _untested(words: str, name: str) -> TestedInequality:
    return TestedInequality(words, name, float("nan"), float("nan"))


def same_share(first: np.ndarray, second: np.ndarray, paired: bool) -> float:
    """Returns the two-sided p-value under the null hypothesis of equal shares.

    Pairs are tested by McNemar's exact test, independent groups by Fisher's exact test. Both are
    exact forms of a permutation test of shares. `first` (n,) and `second` (m,) mark the robots with
    the property. If they are paired, robots of the same index are pairs, and n = m. The p-value is
    NaN if a group has no robots.
    """
    if not (len(first) and len(second)):
        return float("nan")
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
    simulated, since counts may be small: both groups of a pair are drawn from their pooled shares.

    `pairs` holds the number of robots in each class in the first and in the second group.
    """
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


def same_mean(first: np.ndarray, second: np.ndarray, paired: bool) -> float:
    """Returns the two-sided p-value of a permutation test that two groups have equal means.

    For pairs, values are swapped at random within pairs; the statistic is the difference of the
    means. Robots of independent groups are dealt to the two groups at random; the statistic is the
    difference of the means divided by its standard error, which also allows groups of different
    spread and size (Janssen, Statistics and Probability Letters 36, 1997; Chung and Romano, Annals
    of Statistics 41, 2013).

    Permutations are drawn until `_ENOUGH_EXTREME` of them are as extreme as the data: then the
    random error of p is about 2 % (Besag and Clifford, Biometrika 78, 1991). After `_DRAWS`
    permutations, p may rest on fewer extreme ones: about 100 for p = 0.001.

    Args:
      first: Values of the first group, shape (n,).
      second: Values of the second group, shape (m,).
      paired: Whether robots with the same index in both groups are pairs; then n = m.

    Returns:
      The p-value, at least 1 / (`_DRAWS` + 1); NaN for a group of fewer than `FEWEST_RESAMPLED`.
    """
    if min(len(first), len(second)) < FEWEST_RESAMPLED:
        return float("nan")
    random = np.random.default_rng(_SEED)
    if paired:
        permuted, observed = _swapped, abs((first - second).mean())
    else:
        in_first = np.repeat([[True, False]], [len(first), len(second)], axis=1)
        permuted, observed = _dealt, _welch(np.concatenate([first, second]), in_first)[0]
    least = observed * (1 - 1e-9)  # equal but for rounding errors counts as equal
    drawn = extreme = 0
    while drawn < _DRAWS and extreme < _ENOUGH_EXTREME:
        extreme += int((permuted(first, second, random) >= least).sum())
        drawn += _BLOCK
    return (extreme + 1) / (drawn + 1)


def same_deviation(first: np.ndarray, second: np.ndarray, paired: bool) -> float:
    """Returns the two-sided p-value under the null hypothesis of equal standard deviations.

    This is `same_mean` of the values' squared distances from their group's mean.
    """
    if min(len(first), len(second)) < FEWEST_RESAMPLED:
        return float("nan")
    squares = [(values - values.mean()) ** 2 for values in (first, second)]
    return same_mean(squares[0], squares[1], paired)


def _swapped(first: np.ndarray, second: np.ndarray, random: np.random.Generator) -> np.ndarray:
    """Returns absolute differences of the means for random swaps of pairs, shape (_BLOCK,)."""
    kept = random.random((_BLOCK, len(first))) < 0.5
    return np.abs(np.where(kept, first - second, second - first).mean(axis=1))


def _dealt(first: np.ndarray, second: np.ndarray, random: np.random.Generator) -> np.ndarray:
    """Returns Welch's statistic for a block of random partitions of all values, shape (_BLOCK,)."""
    values = np.concatenate([first, second])
    in_first = np.tile(np.arange(len(values)) < len(first), (_BLOCK, 1))
    random.permuted(in_first, axis=1, out=in_first)
    return _welch(values, in_first)


def _welch(values: np.ndarray, in_first: np.ndarray) -> np.ndarray:
    """Returns the absolute difference of two groups' means in standard errors, shape (k,).

    Of the `values`, shape (n,), the first group has those marked in a row of `in_first`, shape
    (k, n), and the second one the others. All rows have equally many marks.
    """
    values = values - values.mean()  # so that sums of squares lose no digits
    sums, squares = in_first.astype(float) @ np.stack([values, values**2]).T, values @ values
    n = int(in_first[0].sum())
    m = len(values) - n
    first, second = sums[:, 0] / n, (values.sum() - sums[:, 0]) / m  # the means
    least = _NO_SCATTER * squares
    within_first = np.maximum(sums[:, 1] - n * first**2, least)
    within_second = np.maximum(squares - sums[:, 1] - m * second**2, least)
    error = np.sqrt(within_first / (n * (n - 1)) + within_second / (m * (m - 1)))
    distance = np.abs(first - second)
    return np.divide(distance, error, out=np.zeros(len(sums)), where=distance > _NO_SCATTER)


def holm(p_values: np.ndarray) -> np.ndarray:
    """Returns the p-values of a family after Holm's step-down correction.

    The k-th smallest of m p-values is multiplied by m - k + 1, and none becomes smaller than the
    one before it (Scandinavian Journal of Statistics 6, 1979). If hypotheses with a corrected
    p-value below alpha are rejected, the probability of rejecting any true one is at most alpha.

    Args:
      p_values: Uncorrected p-values, shape (m,). If the data do not allow a test, its p-value is
        NaN and stays NaN; the test still counts as a member of the family.
    """
    p_values = np.asarray(p_values, dtype=float)
    order = np.argsort(p_values)  # NaN last
    steps = p_values[order] * np.arange(len(p_values), 0, -1)
    corrected = np.empty_like(p_values)
    corrected[order] = np.minimum(np.maximum.accumulate(steps), 1)
    return corrected
