"""95 % intervals of means, standard deviations, shares and differences, computed by SciPy."""

from __future__ import annotations

import warnings
from collections.abc import Callable

import numpy as np
from scipy import stats

from ..results.learn_ability import Summary

LEVEL = 0.95

Interval = tuple[float, float]
"""Lower and upper end; both NaN where the data do not determine them."""

UNKNOWN: Interval = (float("nan"), float("nan"))

FEWEST = 5  # smallest number of robots for which a bootstrap or a test of means is meaningful

_RESAMPLES = 4999
_SEED = 1  # equal data give bit-exact equal intervals


def share(count: int, robots: int) -> Interval:
    """Returns Wilson's interval of a share.

    Args:
      count: Number of robots that have the property.
      robots: Number of all robots.

    Returns:
      Lower and upper end in [0, 1]; unknown without robots.
    """
    if not robots:
        return UNKNOWN
    found = stats.binomtest(count, robots).proportion_ci(LEVEL, method="wilson")
    return float(found.low), float(found.high)


def mean(values: np.ndarray) -> Interval:
    """Returns the BCa bootstrap interval of a mean.

    Args:
      values: One value for each robot, shape (n,).

    Returns:
      Lower and upper end; unknown for fewer than `FEWEST` robots, or if all values are equal.
    """
    return _bootstrap(values, np.mean)


def deviation(values: np.ndarray) -> Interval:
    """Returns the BCa bootstrap interval of the sample's standard deviation.

    Args:
      values: One value for each robot, shape (n,).

    Returns:
      Lower and upper end; unknown for fewer than `FEWEST` robots, or if all values are equal.
    """

    def statistic(samples: np.ndarray, axis: int) -> np.ndarray:
        return np.std(samples, axis=axis, ddof=1)

    return _bootstrap(values, statistic)


def mean_from(summary: Summary) -> Interval:
    """Returns Student's t interval of the mean L, from a column's mean, deviation and robots."""
    measured = summary.robots - summary.counts[-1]
    if measured < 2 or not summary.deviation > 0:
        return UNKNOWN
    scale = summary.deviation / measured**0.5
    low, high = stats.t.interval(LEVEL, measured - 1, loc=summary.mean, scale=scale)
    return float(low), float(high)


def chance_variation(first: Summary, second: Summary) -> float:
    """Returns the total variation that sampling alone exceeds with a probability of 5 %.

    Both groups are drawn from the pooled shares of the two columns, as if all robots belonged to
    one population.

    Args:
      first: A column of table 1 or 2.
      second: The column to compare with.

    Returns:
      The 95th percentile of the total variation, in [0, 1]; NaN where a column has no robots.
    """
    if not first.robots or not second.robots:
        return float("nan")
    counts = np.array(first.counts) + second.counts
    common = counts / counts.sum()
    random = np.random.default_rng(_SEED)
    ours, theirs = (
        random.multinomial(column.robots, common, _RESAMPLES) / column.robots
        for column in (first, second)
    )
    return float(np.quantile(np.abs(ours - theirs).sum(axis=1) / 2, LEVEL))


def difference_of_shares(first: np.ndarray, second: np.ndarray, paired: bool) -> Interval:
    """Returns Newcombe's hybrid score interval of a difference of two shares.

    This is method 10 of both of Newcombe's papers (Statistics in Medicine 17, 1998). It combines
    Wilson's intervals of both shares with the correlation of the pairs, 0 for independent groups.

    Args:
      first: Whether each robot of the first group has the property, shape (n,).
      second: Whether each robot of the second group has the property, shape (m,).
      paired: Whether robots of the same index are pairs; then n = m.

    Returns:
      Interval of the first share minus the second, in [-1, 1]; unknown if a group has no robots.
    """
    if not len(first) or not len(second):
        return UNKNOWN
    p, q = float(np.mean(first)), float(np.mean(second))
    (p_low, p_high), (q_low, q_high) = (share(int(x.sum()), len(x)) for x in (first, second))
    correlation = _correlation(first, second) if paired else 0.0

    def reach(a: float, b: float) -> float:
        return max(0.0, a * a - 2 * correlation * a * b + b * b) ** 0.5

    return p - q - reach(p - p_low, q_high - q), p - q + reach(p_high - p, q - q_low)


def _correlation(first: np.ndarray, second: np.ndarray) -> float:
    """Returns the phi coefficient of pairs, with Newcombe's continuity correction if positive."""
    n, both = len(first), int((first & second).sum())
    a, b = int(first.sum()), int(second.sum())
    scale = float(a * (n - a) * b * (n - b)) ** 0.5
    excess = both * n - a * b  # determinant of the 2 x 2 table
    return (max(excess - n / 2, 0.0) if excess > 0 else excess) / scale if scale else 0.0


def difference(
    first: np.ndarray, second: np.ndarray, statistic: Callable[..., np.ndarray], paired: bool
) -> Interval:
    """Returns the BCa bootstrap interval of a difference of two groups' statistics.

    Args:
      first: Values of the first group, shape (n,); NaN for a robot without a value.
      second: Values of the second group, shape (m,); NaN for a robot without a value.
      statistic: NumPy function that ignores NaN and has an argument `axis`, such as
        `numpy.nanmean`.
      paired: Whether robots of the same index are pairs, resampled together; then n = m.

    Returns:
      Interval of the first statistic minus the second; unknown if a group has fewer than `FEWEST`
      values, or if a resample could contain no values.
    """
    if min((~np.isnan(x)).sum() for x in (first, second)) < FEWEST:
        return UNKNOWN

    def apart(first: np.ndarray, second: np.ndarray, axis: int) -> np.ndarray:
        return statistic(first, axis=axis) - statistic(second, axis=axis)

    return _resampled((first, second), apart, paired)


def _bootstrap(values: np.ndarray, statistic: Callable[..., np.ndarray]) -> Interval:
    values = np.asarray(values, dtype=float)
    # Resampling equal values shows no spread, which does not mean certainty.
    if len(values) < FEWEST or np.ptp(values) == 0:
        return UNKNOWN
    return _resampled((values,), statistic)


def _resampled(
    samples: tuple[np.ndarray, ...], statistic: Callable[..., np.ndarray], paired: bool = False
) -> Interval:
    with warnings.catch_warnings(), np.errstate(all="ignore"):
        warnings.simplefilter("ignore")  # a degenerate sample results in NaN
        found = stats.bootstrap(
            samples,
            statistic,
            paired=paired,
            n_resamples=_RESAMPLES,
            batch=500,
            confidence_level=LEVEL,
            method="BCa",
            rng=np.random.default_rng(_SEED),
        ).confidence_interval
    return float(found.low), float(found.high)
