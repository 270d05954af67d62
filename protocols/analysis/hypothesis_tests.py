"""Hypothesis tests of inequalities and of equality, computed by SciPy, and Holm's correction."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np
from scipy import stats

from .intervals import FEWEST, LEVEL, UNKNOWN, Interval

ALPHA = 0.05
"""Level of all tests: below this p-value, corrected where there are several, one is significant."""

_NO_SCATTER = 1e-12  # rounding: the computed standard deviation of equal values may not be 0
_SEED = 1  # equal data give bit-exact equal p-values
_JOINT_DRAWS = 9999
DRAWS = 100_000  # of permutations, at most
_BLOCK, _ENOUGH = 2_000, 2_000  # of permutations; see `same_mean`


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


def same_mean(first: np.ndarray, second: np.ndarray, paired: bool, draws: int = DRAWS) -> float:
    """Returns the two-sided p-value of a permutation test that two groups have equal means.

    The statistic is the difference of the means divided by its standard error, so that groups of
    different spread and size are tested, too (Janssen, Statistics and Probability Letters 36, 1997;
    Chung and Romano, Annals of Statistics 41, 2013). Pairs are swapped at random; robots of
    independent groups are dealt to the two groups at random.

    Permutations are drawn until `_ENOUGH` of them are as extreme as the data: then the random error
    of p is about 2 % (Besag and Clifford, Biometrika 78, 1991). A smaller p rests on fewer, which
    are at least 100 for a p of 100 / `draws`.

    Args:
      first: Values of the first group, shape (n,); NaN for a robot without a value.
      second: Values of the second group, shape (m,); NaN for a robot without a value.
      paired: Whether robots of the same index are pairs; then n = m.
      draws: Largest number of permutations, a multiple of `_BLOCK`.

    Returns:
      The p-value, at least 1 / (`draws` + 1); NaN where a group has fewer than `FEWEST` values.
    """
    if min((~np.isnan(x)).sum() for x in (first, second)) < FEWEST:
        return float("nan")
    if paired:
        deal, start, apart = _swaps(first, second)
    else:
        deal, start, apart = _deals(first[~np.isnan(first)], second[~np.isnan(second)])
    random = np.random.default_rng(_SEED)
    found = apart(start[None])[0] * (1 - 1e-9)  # equal but for rounding errors counts as equal
    drawn = extreme = 0
    while drawn < draws and extreme < _ENOUGH:
        extreme += int((apart(deal(random)) >= found).sum())
        drawn += _BLOCK
    return (extreme + 1) / (drawn + 1)


def same_deviation(
    first: np.ndarray, second: np.ndarray, paired: bool, draws: int = DRAWS
) -> float:
    """Returns the two-sided p-value under the null hypothesis of equal standard deviations.

    This is `same_mean` of the squared distances from the group's own mean.

    Args:
      first: Values of the first group, shape (n,); NaN for a robot without a value.
      second: Values of the second group, shape (m,); NaN for a robot without a value.
      paired: Whether robots of the same index are pairs; then n = m.
      draws: Largest number of permutations; see `same_mean`.
    """
    if min((~np.isnan(x)).sum() for x in (first, second)) < FEWEST:
        return float("nan")
    squares = [(x - np.nanmean(x)) ** 2 for x in (first, second)]
    return same_mean(squares[0], squares[1], paired, draws)


_Permutation = tuple[
    Callable[[np.random.Generator], np.ndarray], np.ndarray, Callable[[np.ndarray], np.ndarray]
]
"""A function that draws a block of permutations, shape (`_BLOCK`, n), the permutation of the data,
shape (n,), and a function that returns the statistic of each permutation of a block."""


def _deals(first: np.ndarray, second: np.ndarray) -> _Permutation:
    """Returns permutations that deal values to two groups: True where a value is in the first."""
    values = np.concatenate([first, second])
    values = values - values.mean()  # so that little is lost when squares are subtracted
    sizes = len(first), len(second)
    start = np.arange(len(values)) < sizes[0]
    sums = np.stack([values, values**2], axis=1)

    def apart(chosen: np.ndarray) -> np.ndarray:
        parts = chosen.astype(float) @ sums
        means, squares = [], np.zeros(len(chosen))
        for (total, square), size in zip((parts.T, (sums.sum(0) - parts).T), sizes, strict=True):
            means.append(total / size)
            squares = squares + (square - total**2 / size) / (size * (size - 1))
        return _studentized(means[0] - means[1], squares)

    return lambda random: random.permuted(np.tile(start, (_BLOCK, 1)), axis=1), start, apart


def _swaps(first: np.ndarray, second: np.ndarray) -> _Permutation:
    """Returns permutations that swap the values of pairs: False where a pair is swapped.

    The standard error is that of the robots' contributions to the difference, which are correlated
    within a pair; where all have both values, this is that of the mean difference.
    """
    middle = np.nanmean([np.nanmean(first), np.nanmean(second)])
    known = [~np.isnan(x) for x in (first, second)]
    values = [np.where(k, x - middle, 0.0) for k, x in zip(known, (first, second), strict=True)]
    both = known[0] & known[1]
    product = float((values[0] * values[1]).sum())
    columns = [np.stack([k, x, x**2, both * x], 1) for k, x in zip(known, values, strict=True)]
    stays, total = columns[0] - columns[1], columns[0].sum(0) + columns[1].sum(0)

    def apart(kept: np.ndarray) -> np.ndarray:
        ours = kept.astype(float) @ stays + columns[1].sum(0)
        sides = ours.T, (total - ours).T
        with np.errstate(divide="ignore", invalid="ignore"):  # a side without values
            means = [side[1] / side[0] for side in sides]
            squares = [
                (side[2] - side[0] * mean**2) / side[0] ** 2
                for side, mean in zip(sides, means, strict=True)
            ]
            shared = product - means[1] * sides[0][3] - means[0] * sides[1][3]
            shared = (shared + both.sum() * means[0] * means[1]) / (sides[0][0] * sides[1][0])
        return _studentized(means[0] - means[1], squares[0] + squares[1] - 2 * shared)

    start = np.ones(len(first), dtype=bool)
    return lambda random: random.random((_BLOCK, len(first))) < 0.5, start, apart


def _studentized(difference: np.ndarray, variance: np.ndarray) -> np.ndarray:
    """Returns the differences in standard errors, not below 0.

    Infinite where values of both groups do not scatter, or where a group is left without values,
    which errs towards no difference.
    """
    error = np.sqrt(np.fmax(variance, 0.0))
    distance = np.abs(difference)
    scatters = error > _NO_SCATTER
    found = np.divide(distance, error, out=np.full(distance.shape, np.inf), where=scatters)
    return np.where(~scatters & (distance < _NO_SCATTER), 0.0, found)


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
    """Returns a weighted sum of group means of the same robots, its 95 % interval and p-value.

    This is Student's t test of the robots' own weighted sums, so that values of one robot in
    several groups may be correlated.

    Args:
      groups: Values of the same robots in each group, shapes (n,); NaN for a robot without a value,
        which is left out of all groups.
      weights: Weight of each group's mean.

    Returns:
      The sum, its interval, and the two-sided p-value under the null hypothesis that the sum of the
      true means is 0. Interval and p-value are unknown for fewer than `FEWEST` robots, or if the
      sums do not scatter.
    """
    sums = np.asarray(weights, dtype=float) @ np.stack(groups)
    sums = sums[~np.isnan(sums)]
    value = float(sums.mean()) if len(sums) else float("nan")
    if len(sums) < FEWEST or sums.std() < _NO_SCATTER:
        return value, UNKNOWN, float("nan")
    found: Any = stats.ttest_1samp(sums, 0.0)
    low, high = found.confidence_interval(LEVEL)
    return value, (float(low), float(high)), float(found.pvalue)


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
