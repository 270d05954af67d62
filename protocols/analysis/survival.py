"""Times to an event that some robots never reach: Kaplan-Meier curves, log-rank tests (SciPy)."""

from __future__ import annotations

import dataclasses
import math
import warnings
from typing import Any

import numpy as np
from scipy import stats

from .intervals import LEVEL, Interval
from .intervals import share as share_of


@dataclasses.dataclass(frozen=True)
class Durations:
    """Times of N robots to an event.

    Attributes:
      times: Time of the event; for a robot without it, the time until which it was observed
        (right-censored), shape (N,).
      happened: Whether the event happened, shape (N,).
    """

    times: np.ndarray
    happened: np.ndarray

    def __len__(self) -> int:
        """Returns the number of robots, N."""
        return len(self.times)

    @property
    def censored(self) -> Any:
        """The times as SciPy's `CensoredData`."""
        return stats.CensoredData(
            uncensored=self.times[self.happened], right=self.times[~self.happened]
        )


@dataclasses.dataclass(frozen=True)
class Curve:
    """Kaplan-Meier estimate of the share of robots without the event.

    Attributes:
      times: Times at which the share falls or a robot is censored, shape (T,).
      share: Share of robots without the event just after each time, shape (T,).
      low: Lower end of the share's 95 % interval (log-log), shape (T,).
      high: Upper end of the share's 95 % interval (log-log), shape (T,).
    """

    times: np.ndarray
    share: np.ndarray
    low: np.ndarray
    high: np.ndarray

    @property
    def median(self) -> float:
        """First time at which at most half of the robots are without the event, or infinity."""
        return self._reached(self.share)

    @property
    def median_interval(self) -> Interval:
        """95 % interval of the median, from the curve's interval; its upper end may be infinite."""
        return self._reached(self.low), self._reached(self.high)

    def _reached(self, share: np.ndarray) -> float:
        below = np.flatnonzero(share <= 0.5 + 1e-12)
        return float(self.times[below[0]]) if len(below) else math.inf


def kaplan_meier(durations: Durations) -> Curve:
    """Returns the Kaplan-Meier curve of some robots' times.

    Raises:
      ValueError: there is no robot.
    """
    if not len(durations):
        raise ValueError("a Kaplan-Meier curve needs at least one robot, got none")
    found = stats.ecdf(durations.censored).sf
    with warnings.catch_warnings(), np.errstate(all="ignore"):
        warnings.simplefilter("ignore")  # where the share is 0 or 1 the log-log interval is unknown
        band = found.confidence_interval(LEVEL, method="log-log")
    share = found.probabilities
    low, high = (
        np.where(np.isnan(end.probabilities), share, end.probabilities)
        for end in (band.low, band.high)
    )
    # A share of 0 leaves the upper end where it was: few robots do not show that none are left.
    # Where all robots have the event at one time, it is Wilson's.
    ended = share == 0
    high[ended] = share_of(0, len(durations))[1] if ended.all() else high[~ended][-1]
    return Curve(found.quantiles, share, low, high)


def restricted(durations: Durations, until: float) -> np.ndarray:
    """Returns each robot's time up to a limit, whose mean is the restricted mean time.

    Args:
      durations: Times of N robots; none is censored before the limit, except where a
        simulation became unstable.
      until: Limit; a robot without the event counts as this.

    Returns:
      Times, shape (N,).
    """
    return np.where(durations.happened, np.minimum(durations.times, until), until)


def log_rank(first: Durations, second: Durations) -> float:
    """Returns the two-sided p-value of the log-rank test of equal times in independent groups.

    Returns:
      The p-value; NaN if a group is empty, or no event or nothing but simultaneous events of all
      robots leave the test undetermined.
    """
    if not len(first) or not len(second) or not (first.happened.any() or second.happened.any()):
        return math.nan
    with warnings.catch_warnings(), np.errstate(all="ignore"):
        warnings.simplefilter("ignore")
        return float(stats.logrank(first.censored, second.censored).pvalue)
