"""Learn Ability (Eq. 4), the classes of tables 1 and 2, and a table's column."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np

CATEGORIES = ("L = 1", "0 < L < 1", "L = 0", "L < 0", "unmeasured")
INVALID = "invalid"
DECIMALS = 2  # to which L is rounded before it is classed: the paper's counts of L = 0 need it


def learn_ability(pre: np.ndarray, post: np.ndarray, wanted: bool) -> np.ndarray:
    """Computes Eq. 4, L = (t_pre - t_post) / (t_pre + t_post), or -L for time in the spot.

    Args:
      pre: Time in contact, or in the spot, in the test before training, any unit, shape (n,).
      post: Time in contact, or in the spot, in the test after training, same unit, shape (n,).
      wanted: Whether the event is wanted: False for contact, True for being in the spot.

    Returns:
      L in [-1, 1], shape (n,); NaN where both times are zero (genius or ignorant).
    """
    pre, post = np.asarray(pre, dtype=float), np.asarray(post, dtype=float)
    total = pre + post
    gain = post - pre if wanted else pre - post
    return np.divide(gain, total, out=np.full(total.shape, np.nan), where=total > 0)


def category(ability: float) -> str:
    """Returns the class of an exact Learn Ability; "unmeasured" for NaN."""
    if np.isnan(ability):
        return "unmeasured"
    if ability == 1:
        return "L = 1"
    if ability > 0:
        return "0 < L < 1"
    return "L = 0" if ability == 0 else "L < 0"


def classes(abilities: Sequence[float] | np.ndarray, exact: bool = False) -> list[str]:
    """Returns the class (a row of tables 1 and 2) of each Learn Ability.

    Args:
      abilities: L of each robot, shape (n,); NaN for a genius or an ignorant.
      exact: Whether robots are classed by their exact L; otherwise L is first rounded to two
        decimals, so that times that differ by less than 1 % give L = 0.
    """
    values = np.asarray(abilities, dtype=float)
    return [category(ability) for ability in (values if exact else np.round(values, DECIMALS))]


@dataclasses.dataclass(frozen=True)
class Summary:
    """A column of table 1 or 2.

    Attributes:
      counts: Number of robots in each class, in the order of `CATEGORIES`.
      mean: Mean L of the robots that have a Learn Ability; NaN if none has.
      deviation: Standard deviation of L over the robots that have a Learn Ability.
      post_share: In the test after training, the share of the time in contact, or in the spot;
        mean over all valid robots.
      invalid: Number of robots that were stopped: unstable, or with a weight that is not finite.
        No other attribute counts them.
    """

    counts: tuple[int, int, int, int, int]
    mean: float
    deviation: float
    post_share: float
    invalid: int = 0

    @property
    def robots(self) -> int:
        """Number of valid robots."""
        return sum(self.counts)

    @property
    def shares(self) -> np.ndarray:
        """Share of the robots in each class, shape (5,)."""
        return np.array(self.counts) / max(self.robots, 1)


def summarise(
    abilities: Sequence[float] | np.ndarray,
    post_times: Sequence[float],
    test_time: float,
    invalid: int = 0,
    exact: bool = False,
) -> Summary:
    """Summarises valid robots as tables 1 and 2 do.

    Args:
      abilities: L of each of n robots, shape (n,); NaN for a genius or an ignorant.
      post_times: Time of each robot in contact, or in the spot, after training, in [s], shape (n,).
      test_time: Duration of the test after training, in [s].
      invalid: Number of invalid robots, which are not among the n robots.
      exact: Whether L is classed without rounding, see `classes`; mean and deviation are never
        rounded.
    """
    rows = classes(abilities, exact)
    measured = np.array([ability for ability in abilities if not np.isnan(ability)])
    return Summary(
        counts=tuple(rows.count(name) for name in CATEGORIES),  # type: ignore[arg-type]
        mean=float(measured.mean()) if len(measured) else float("nan"),
        deviation=float(measured.std(ddof=1)) if len(measured) > 1 else float("nan"),
        post_share=float(np.mean(post_times) / test_time) if len(post_times) else float("nan"),
        invalid=invalid,
    )


def total_variation(first: Summary, second: Summary) -> float:
    """Returns half the sum of the absolute differences of two columns' shares, in [0, 1]."""
    return float(np.abs(first.shares - second.shares).sum() / 2)
