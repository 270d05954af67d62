"""95 % intervals of means, standard deviations, shares and differences.

One rule (`_is_near_an_end`) chooses the method for every mean and every difference of means:
Gaffke's bounds where the mean is near an end of its range, such as a share of time in contact near
0, and SciPy's BCa bootstrap otherwise. A bootstrap misses the rare robots that a sample lacks: near
an end, BCa covers the mean in 0.3 to 0.8 of samples from our stored runs, not in 0.95.
"""

from __future__ import annotations

import functools
import warnings
from collections.abc import Callable

import numpy as np
from scipy import stats

from ..runs.learn_ability import Summary

LEVEL = 0.95

Interval = tuple[float, float]
"""Lower and upper end; both NaN where the data do not determine them."""

UNKNOWN: Interval = (float("nan"), float("nan"))

SHARE = (0.0, 1.0)
"""Range of a share of time."""

ABILITY = (-1.0, 1.0)
"""Range of the Learn Ability L."""

FEWEST_RESAMPLED = 5  # robots for which a bootstrap or a test of means is meaningful

_NEAR_AN_END = 5  # the usual least n p and n (1 - p) for a normal approximation of a share
_RESAMPLES = 4999
_DRAWS = 9999  # of Gaffke's bounds; an end's random error: below 2 % of its distance to the mean
_SEED = 1  # equal data give bit-exact equal intervals


def share(count: int, robots: int) -> Interval:
    """Returns Wilson's interval of the share `count` / `robots` in [0, 1]; unknown for 0 robots."""
    if not robots:
        return UNKNOWN
    found = stats.binomtest(count, robots).proportion_ci(LEVEL, method="wilson")
    return float(found.low), float(found.high)


def mean(values: np.ndarray, span: Interval | None = None) -> Interval:
    """Returns the interval of a mean: Gaffke's near an end of the range, else the BCa bootstrap.

    Args:
      values: One value for each robot, shape (n,).
      span: Lowest and highest value that a robot can have, such as `SHARE`; None if not known.

    The interval is unknown for fewer robots than `FEWEST_RESAMPLED`, and for equal values that are
    not near an end of `span`.
    """
    values = np.asarray(values, dtype=float)
    if len(values) >= FEWEST_RESAMPLED and span and _is_near_an_end(values, span):
        return _gaffke(values, span)
    return _resampled((values,), np.mean)


def _is_near_an_end(values: np.ndarray, span: Interval) -> bool:
    """Returns whether the mean of n values is within 5 / n of an end of their range.

    The distance is a share of the range. If all values are ends of the range, "not near" is the
    textbooks' rule for a share p to be about normal: n p and n (1 - p) are at least 5.
    """
    low, high = span
    share = (values.mean() - low) / (high - low)
    return len(values) * min(share, 1 - share) < _NEAR_AN_END


def _gaffke(values: np.ndarray, span: Interval) -> Interval:
    """Returns Gaffke's bounds of the mean of a bounded variable.

    Each bound is a quantile of the mean of the values and one end of their range, weighted by the
    spacings of n uniform variables. The end stands for the robots that the sample lacks. If all
    values are ends of the range, the bounds are Clopper's and Pearson's. Coverage of at least
    `LEVEL` is conjectured for all distributions; `tests/analysis/test_intervals.py` simulates it.

    Sources: Gaffke, Mathematical Methods of Statistics 14 (2005); Learned-Miller and Thomas, "A new
    confidence interval for the mean of a bounded random variable", arXiv:1905.06208.
    """
    random = np.random.default_rng(_SEED)
    ends = []
    for end, level in zip(span, ((1 - LEVEL) / 2, (1 + LEVEL) / 2), strict=True):
        points, counts = np.unique([*values, end], return_counts=True)
        ends.append(float(np.quantile(random.dirichlet(counts, _DRAWS) @ points, level)))
    return ends[0], ends[1]


def deviation(values: np.ndarray) -> Interval:
    """Returns the BCa bootstrap interval of the standard deviation of n values, shape (n,).

    It is unknown for fewer robots than `FEWEST_RESAMPLED`, or if all values are equal.
    """
    return _resampled((np.asarray(values, dtype=float),), functools.partial(np.std, ddof=1))


def mean_from(summary: Summary) -> Interval:
    """Returns Student's t interval of the mean L, from a column's mean, deviation and counts."""
    measured = summary.robots - summary.counts[-1]
    scale = summary.deviation / measured**0.5
    low, high = stats.t.interval(LEVEL, measured - 1, loc=summary.mean, scale=scale)
    return float(low), float(high)


def chance_variation(first: Summary, second: Summary) -> float:
    """Returns the total variation that sampling alone exceeds with a probability of 5 %.

    Both groups are drawn from the pooled shares of two columns of table 1 or 2, as if all robots
    belonged to one population.

    Returns:
      The 95th percentile of the total variation, in [0, 1].
    """
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

    `first` (n,) and `second` (m,) mark the robots with the property. If they are paired, robots of
    the same index are pairs, and n = m. The interval of the first share minus the second lies in
    [-1, 1], and is unknown if a group has no robots.
    """
    if not len(first) or not len(second):
        return UNKNOWN
    values = float(np.mean(first)), float(np.mean(second))
    ends = share(int(first.sum()), len(first)), share(int(second.sum()), len(second))
    return _combined(values, ends, _correlation(first, second) if paired else 0.0)


def _combined(
    values: tuple[float, float], ends: tuple[Interval, Interval], correlation: float = 0.0
) -> Interval:
    """Returns the interval of a difference from the intervals of its two values.

    This is the method of variance estimates recovery (Zou and Donner, Statistics in Medicine 27,
    2008), of which Newcombe's method 10 is the case of two shares.
    """
    (p, q), ((p_low, p_high), (q_low, q_high)) = values, ends

    def reach(a: float, b: float) -> float:
        square = a * a - 2 * correlation * a * b + b * b
        return 0.0 if square < 0 else square**0.5  # NaN of an unknown end stays NaN

    return p - q - reach(p - p_low, q_high - q), p - q + reach(p_high - p, q - q_low)


def _correlation(first: np.ndarray, second: np.ndarray) -> float:
    """Returns the phi coefficient of pairs, with Newcombe's continuity correction if positive."""
    n, both = len(first), int((first & second).sum())
    a, b = int(first.sum()), int(second.sum())
    scale = float(a * (n - a) * b * (n - b)) ** 0.5
    excess = both * n - a * b  # determinant of the 2 x 2 table
    return (max(excess - n / 2, 0.0) if excess > 0 else excess) / scale if scale else 0.0


def difference_of_means(
    first: np.ndarray, second: np.ndarray, paired: bool, span: Interval
) -> Interval:
    """Returns the interval of a difference of two groups' means.

    If a mean is near an end of the range, the intervals of both means are combined as those of
    independent groups, also for pairs: a correlation that rests on a few robots is not reliable.
    Otherwise this is the BCa bootstrap's interval.

    Args:
      first: Values of the first group, shape (n,); NaN for a robot without a value.
      second: Values of the second group, shape (m,); NaN for a robot without a value.
      paired: Whether robots of the same index are pairs, resampled together; then n = m.
      span: Lowest and highest possible value of the measure, such as `SHARE`.

    Returns:
      Interval of the first mean minus the second. It is unknown if a group has fewer values than
      `FEWEST_RESAMPLED`, or if all resamples are equal. It is also unknown if one mean is near an
      end of `span`, while all values of the other group are equal and not near an end.
    """
    measured = first[~np.isnan(first)], second[~np.isnan(second)]
    enough = min(map(len, measured)) >= FEWEST_RESAMPLED
    if enough and any(_is_near_an_end(values, span) for values in measured):
        means = float(measured[0].mean()), float(measured[1].mean())
        return _combined(means, (mean(measured[0], span), mean(measured[1], span)))
    return difference(first, second, np.nanmean, paired)


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
      Interval of the first statistic minus the second; unknown if a group has fewer values than
      `FEWEST_RESAMPLED`, if a resample consists of NaN only, or if all resamples are equal.
    """

    def apart(first: np.ndarray, second: np.ndarray, axis: int) -> np.ndarray:
        return statistic(first, axis=axis) - statistic(second, axis=axis)

    return _resampled((first, second), apart, paired)


def _resampled(
    samples: tuple[np.ndarray, ...], statistic: Callable[..., np.ndarray], paired: bool = False
) -> Interval:
    if min((~np.isnan(x)).sum() for x in samples) < FEWEST_RESAMPLED:
        return UNKNOWN
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
    return of_resamples(found.low, found.high)


def of_resamples(low: float, high: float) -> Interval:
    """Returns an interval of resampled values.

    Resampling equal values shows no spread, which does not mean certainty: it is then unknown.
    """
    return (float(low), float(high)) if high - low > 1e-12 else UNKNOWN
