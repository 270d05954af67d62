"""Learn Ability (Eq. 4), the categories of tables 1 and 2, and their summaries."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np

CATEGORIES = ("L = 1", "0 < L < 1", "L = 0", "L < 0", "unmeasured")
INVALID = "invalid"


def learn_ability(pre: np.ndarray, post: np.ndarray, wanted: bool) -> np.ndarray:
    """Eq. 4, L = (t_pre - t_post) / (t_pre + t_post); the other sign where time is wanted.

    Args:
      pre: time before training, in any unit, shape (n,).
      post: time after training, in the same unit, shape (n,).
      wanted: False for wall contact, True for time in the spot.

    Returns:
      L in [-1, 1], shape (n,); NaN where both times are zero (a genius, an ignorant).
    """
    pre, post = np.asarray(pre, dtype=float), np.asarray(post, dtype=float)
    total = pre + post
    gain = post - pre if wanted else pre - post
    return np.divide(gain, total, out=np.full(total.shape, np.nan), where=total > 0)


def category(ability: float) -> str:
    """The row of tables 1 and 2 that a Learn Ability stands in; NaN is "unmeasured"."""
    if np.isnan(ability):
        return "unmeasured"
    if ability == 1:
        return "L = 1"
    if ability > 0:
        return "0 < L < 1"
    return "L = 0" if ability == 0 else "L < 0"


@dataclasses.dataclass(frozen=True)
class Summary:
    """A column of table 1 or 2.

    Attributes:
      counts: robots in each of `CATEGORIES`.
      mean: of L, without the unmeasured; NaN if nobody was measured.
      deviation: standard deviation of L, likewise.
      post_share: mean share of the test time after training, over all robots.
      invalid: lives that ended in an unstable simulation, counted nowhere else.
    """

    counts: tuple[int, int, int, int, int]
    mean: float
    deviation: float
    post_share: float
    invalid: int = 0

    @property
    def robots(self) -> int:
        """How many valid lives the column rests on."""
        return sum(self.counts)

    @property
    def shares(self) -> np.ndarray:
        """The share of the robots in each category, shape (5,)."""
        return np.array(self.counts) / max(self.robots, 1)


def summarise(
    abilities: Sequence[float] | np.ndarray,
    post_times: Sequence[float],
    test_time: float,
    invalid: int = 0,
) -> Summary:
    """Summarises valid lives as tables 1 and 2 do.

    Args:
      abilities: L of each robot, NaN for the unmeasured.
      post_times: of each robot, in seconds.
      test_time: how long the test after training lasts, in seconds.
      invalid: lives left out.
    """
    rows = [category(ability) for ability in abilities]
    measured = np.array([ability for ability in abilities if not np.isnan(ability)])
    return Summary(
        counts=tuple(rows.count(name) for name in CATEGORIES),  # type: ignore[arg-type]
        mean=float(measured.mean()) if len(measured) else float("nan"),
        deviation=float(measured.std(ddof=1)) if len(measured) > 1 else float("nan"),
        post_share=float(np.mean(post_times) / test_time) if len(post_times) else float("nan"),
        invalid=invalid,
    )


def total_variation(first: Summary, second: Summary) -> float:
    """Half the summed difference of two columns' category shares, in [0, 1]."""
    return float(np.abs(first.shares - second.shares).sum() / 2)


PAPER: dict[tuple[str, str], Summary] = {
    # Table 1, 500 robots a column.
    ("wall_avoidance", "fixed"): Summary((260, 12, 13, 19, 196), 0.8232, 0.4959, 0.0584),
    ("wall_avoidance", "random"): Summary((196, 215, 1, 51, 37), 0.7150, 0.5137, 0.0160),
    ("wall_avoidance", "creative"): Summary((282, 65, 0, 80, 73), 0.6109, 0.7068, 0.0402),
    # Table 2, likewise.
    ("spot_finding", "fixed"): Summary((22, 2, 1, 20, 455), 0.0800, 0.9681, 0.0440),
    ("spot_finding", "random"): Summary((20, 16, 0, 323, 141), -0.8064, 0.5631, 0.0296),
    ("spot_finding", "creative"): Summary((109, 63, 1, 170, 157), 0.0045, 0.8829, 0.2581),
}
