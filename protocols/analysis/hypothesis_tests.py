"""One number against another: the statistical tests, SciPy's, that claims rest on."""

from __future__ import annotations

import dataclasses
import warnings
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from scipy import stats

from .intervals import FEWEST

_NO_SCATTER = 1e-12  # the standard deviation of equal values may differ from 0 by rounding
_SEED = 1  # the same lives give the same p values, to the last digit


class Sample(NamedTuple):
    """What a test of means needs to know of some values: mean, standard deviation, how many."""

    mean: float
    deviation: float
    size: int


@dataclasses.dataclass(frozen=True)
class Comparison:
    """One inequality that a claim needs.

    Attributes:
      words: what is compared, with its numbers.
      test: by which test.
      p_false: one-sided p value of the data if the inequality were false: small, it is true. NaN
        where the data do not allow the test.
      p_true: likewise if it were true: small, it is false.
    """

    words: str
    test: str
    p_false: float
    p_true: float


def larger_share(
    first: tuple[int, int], second: tuple[int, int], words: str, times: float = 1
) -> Comparison:
    """Whether one share is larger than so many times another.

    Args:
      first: robots that have the property, and all of them.
      second: likewise.
      words: what is compared.
      times: how much larger. 1 is Fisher's exact test. For more, given how many have the property
        in both groups together, those of the first are binomial if shares are small, and less
        scattered else: the test errs on the side of undecided.
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


def majority(count: int, robots: int, words: str, border: float = 0.5) -> Comparison:
    """Whether a share is larger than a border."""
    return _both_ways(
        words,
        "Binomial test",
        lambda side: stats.binomtest(count, robots, border, alternative=side),
    )


def larger_mean(first: Sample, second: Sample, words: str, margin: float = 0.0) -> Comparison:
    """Whether one mean is larger than another by more than a margin: Welch's t test.

    Args:
      first: what is compared.
      second: with what.
      words: the same in words.
      margin: may be negative: larger, or smaller by less than that.
    """
    if (fewest := min(first.size, second.size)) < FEWEST:
        return _untested(f"{words}: {fewest} measured robots are too few", "Welch's t test")
    if max(first.deviation, second.deviation) < _NO_SCATTER:
        return _untested(f"{words}: no scatter to judge by", "Welch's t test")
    pair = (first.mean - margin, *first[1:], *second)
    return _both_ways(
        words,
        "Welch's t test",
        lambda side: stats.ttest_ind_from_stats(*pair, equal_var=False, alternative=side),
    )


def larger_in_pairs(first: np.ndarray, second: np.ndarray, words: str) -> Comparison:
    """Whether one of each robot's two values tends to be larger: Wilcoxon's signed-rank test."""
    differences = first - second
    differences = differences[differences != 0]
    if len(differences) < FEWEST:
        return _untested(f"{words}: too few robots to tell", "Wilcoxon's signed-rank test")
    return _both_ways(
        words,
        "Wilcoxon's signed-rank test",
        lambda side: stats.wilcoxon(differences, alternative=side),
    )


def same_share(first: np.ndarray, second: np.ndarray, paired: bool) -> float:
    """The two-sided p value of two shares, if robots of both groups are of one kind.

    McNemar's exact test of pairs, else Fisher's: what a permutation test of a share comes to.

    Args:
      first: which robots have the property, shape (n,).
      second: likewise in the other group, shape (m,).
      paired: whether robots of the same index are pairs; then n = m.
    """
    if paired:
        only_first, only_second = int((first & ~second).sum()), int((second & ~first).sum())
        changed = only_first + only_second
        return float(stats.binomtest(only_first, changed).pvalue) if changed else 1.0
    table = [[int(x.sum()), int((~x).sum())] for x in (first, second)]
    found: Any = stats.fisher_exact(table)
    return float(found.pvalue)


def same_statistic(
    first: np.ndarray,
    second: np.ndarray,
    statistic: Callable[..., np.ndarray],
    paired: bool,
    resamples: int,
) -> float:
    """The two-sided p value of two groups' statistics, if robots of both are of one kind.

    A permutation test: pairs are swapped at random, or robots dealt anew to the two groups.

    Args:
      first: values, NaN for a robot that has none, shape (n,).
      second: likewise, shape (m,).
      statistic: of values along an axis, without the NaN, as `numpy.nanmean`.
      paired: whether robots of the same index are pairs; then n = m.
      resamples: how many permutations; there is no p value below 1 / (resamples + 1).

    Returns:
      NaN where a group has very few values.
    """
    if min((~np.isnan(x)).sum() for x in (first, second)) < FEWEST:
        return float("nan")

    def apart(first: np.ndarray, second: np.ndarray, axis: int) -> np.ndarray:
        distance = np.abs(statistic(first, axis=axis) - statistic(second, axis=axis))
        # Rounded: what arithmetic alone makes smaller than the data's own would count against
        # them. Infinite where a group is left without values: errs on the side of no difference.
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


def holm(p_values: np.ndarray) -> np.ndarray:
    """Holm's step-down correction of a family's p values, shape (m,).

    The k-th smallest is multiplied by m - k + 1, and none is made smaller than one before it
    (Scandinavian Journal of Statistics 6, 1979). Compared with alpha, one or more of the true
    hypotheses is rejected with a probability of at most alpha. What could not be tested, NaN,
    counts as a member of the family, and stays NaN.
    """
    p_values = np.asarray(p_values, dtype=float)
    order = np.argsort(p_values)  # NaN last
    steps = p_values[order] * np.arange(len(p_values), 0, -1)
    corrected = np.empty_like(p_values)
    corrected[order] = np.minimum(np.maximum.accumulate(steps), 1)
    return corrected


def _both_ways(words: str, name: str, test: Callable[[str], Any]) -> Comparison:
    greater, less = (float(test(side).pvalue) for side in ("greater", "less"))
    return Comparison(words, name, greater, less)


def _untested(words: str, name: str) -> Comparison:
    return Comparison(words, name, float("nan"), float("nan"))
