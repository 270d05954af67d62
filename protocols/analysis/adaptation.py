"""How robots adapt in a life that changes: online score, recovery, savings, forgetting.

Everything is computed for each robot first. After a change, old robots are compared with newborn
robots in the same world. The measures and their sources are in docs/lives.md.
"""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Sequence

import numpy as np

from ...tasks.lives import Life, control_steps
from ..runs.conditions import Condition
from ..runs.run import Run
from .intervals import FEWEST_RESAMPLED, UNKNOWN, Interval, of_resamples

FAILED = 0.1
"""Online score below which a life has failed."""

RECOVERED = 0.5
"""Score, 0 at the lower bound and 1 at the upper, at which a robot has recovered."""

WINDOW = 5
"""Minutes over which scores are averaged: for recovery, and at a phase's beginning and end."""


Newborns = Sequence[np.ndarray]
"""Recovery in minutes of m newborns in each of a life's W worlds: W arrays of shape (m,)."""


@dataclasses.dataclass(frozen=True)
class Bounds:
    """Lower and upper bounds of the share of time at the goal, in each of a life's W worlds.

    Attributes:
      low: Mean share of time that untrained robots spend at the goal, shape (W,).
      high: Mean share of time at the goal that a policy made for the world reaches, shape (W,).
    """

    low: np.ndarray
    high: np.ndarray

    def of_world(self, number: int) -> Bounds:
        """Returns the bounds of a life that has only the world with index `number`."""
        return Bounds(self.low[[number]], self.high[[number]])


@dataclasses.dataclass(frozen=True)
class Adaptation:
    """How n robots adapted in the P phases of a life.

    Attributes:
      scores: Mean score in each phase, shape (n, P). A score is 0 at the lower bound of the
        phase's world, and 1 at the upper bound.
      online: Mean score over the life, weighted by the phases' minutes, shape (n,).
      recovery: Minute of each phase, counted from 1, in which a robot recovers, shape (n, P): the
        first minute of the first `WINDOW` minutes with a mean score of at least `RECOVERED`. If
        a robot does not recover, the value is the phase's last minute.
      before: Mean score in the last `WINDOW` minutes of each phase, shape (n, P).
      after: Mean score in the first `WINDOW` minutes of each phase, shape (n, P).
      worlds: Index of each phase's world in `Life.worlds`, shape (P,).
    """

    scores: np.ndarray
    online: np.ndarray
    recovery: np.ndarray
    before: np.ndarray
    after: np.ndarray
    worlds: np.ndarray

    @classmethod
    def of(cls, shares: np.ndarray, life: Life, bounds: Bounds) -> Adaptation:
        """Computes the measures from robots' shares of each minute at the goal, shape (n, M)."""
        numbers = [life.worlds.index(phase.world) for phase in life.phases]
        worlds = np.array(numbers)
        parts = []
        for minutes, world in zip(minutes_of_phases(life), numbers, strict=True):
            low, span = bounds.low[world], bounds.high[world] - bounds.low[world]
            # In a shortened life, the bounds may be equal.
            own = (shares[:, minutes] - low) / (span if span > 0 else np.nan)
            ends = own[:, -WINDOW:].mean(axis=1), own[:, :WINDOW].mean(axis=1)
            parts.append((own.mean(axis=1), _recovery(own), *ends))
        scores, recovery, before, after = np.array(parts).transpose(1, 2, 0)
        minutes = np.array([phase.minutes for phase in life.phases])
        online = scores @ (minutes / minutes.sum())
        return cls(scores, online, recovery, before, after, worlds)

    @property
    def failed(self) -> np.ndarray:
        """Whether each life has failed: its online score is below `FAILED`, shape (n,)."""
        return self.online < FAILED

    def worst_tenth(self) -> float:
        """Returns the mean online score of the tenth of the robots with the lowest scores."""
        count = -(-len(self.online) // 10)
        return float(np.sort(self.online)[:count].mean())

    def relative_recovery(self, newborns: Newborns) -> np.ndarray:
        """Returns mean recovery after each change divided by that of newborns in the same world.

        Below 1, the old robots recover faster. The shape is (P - 1,).
        """
        means = np.array([one.mean() for one in newborns])
        return (self.recovery.mean(axis=0) / means[self.worlds])[1:]

    def last_recovery(self, newborns: Newborns, returns: int) -> tuple[float, Interval]:
        """Returns mean relative recovery in the last `returns` phases, and its interval.

        A percentile bootstrap resamples the old robots, which are also the newborns of the first
        world, and the newborns of each other world. The interval is unknown if a world has fewer
        newborns than `FEWEST_RESAMPLED`.
        """
        mean = float(self.relative_recovery(newborns)[-returns:].mean())
        if min(map(len, newborns)) < FEWEST_RESAMPLED:
            return mean, UNKNOWN
        random, draws = np.random.default_rng(1), 4999

        def drawn(robots: int) -> np.ndarray:
            return random.integers(robots, size=(draws, robots))

        own = drawn(len(self.recovery))
        rows = [own, *(drawn(len(one)) for one in newborns[1:])]
        controls = np.array(
            [one[row].mean(axis=1) for one, row in zip(newborns, rows, strict=True)]
        )
        old = self.recovery[:, -returns:][own].mean(axis=1)
        ratios = (old / controls[self.worlds[-returns:]].T).mean(axis=1)
        low, high = np.quantile(ratios, (0.025, 0.975))
        return mean, of_resamples(low, high)

    def slope(self, newborns: Newborns) -> float:
        """Returns the slope of log2 `relative_recovery` per phase, by linear regression.

        Only phases in worlds that the robot knows count. Positive: recovery becomes slower with
        age, as by a loss of plasticity, by interference or by overlearning.
        """
        returns = [k for k, world in enumerate(self.worlds) if world in self.worlds[:k]]
        relative = np.log2(self.relative_recovery(newborns))[np.array(returns) - 1]
        return float(np.polyfit(returns, relative, 1)[0])

    def first_and_last(self) -> np.ndarray:
        """Returns each robot's mean recovery at first and at last visits to worlds, shape (2, n).

        The world of birth is left out, in which much of the first visit may be spent exploring.
        NaN if no other world returns.
        """
        visits = [own for own in self.visits() if own[0] > 0]
        if not visits:
            return np.full((2, len(self.recovery)), np.nan)
        ends = ([own[k] for own in visits] for k in (0, -1))
        return np.array([self.recovery[:, phases].mean(axis=1) for phases in ends])

    def savings(self) -> float:
        """Returns the share by which recovery is faster at last visits to worlds than at first."""
        first, last = self.first_and_last().mean(axis=1)
        return float(1 - last / first)

    def forgetting(self) -> float:
        """Returns mean score at the end of a visit to a world minus that at the start of the next.

        NaN if no world returns.
        """
        lost = [
            (self.before[:, left] - self.after[:, back]).mean()
            for own in self.visits()
            for left, back in itertools.pairwise(own)
        ]
        return float(np.mean(lost)) if lost else float("nan")

    def visits(self) -> list[np.ndarray]:
        """Returns the indices of the phases in each world that returns, in ascending order."""
        visits = [np.flatnonzero(self.worlds == world) for world in np.unique(self.worlds)]
        return [own for own in visits if len(own) > 1]


def minutes_of_phases(life: Life) -> list[np.ndarray]:
    """Returns the indices of the minutes of which a part is in each phase.

    In a short life, two phases may share a minute, as stages do in `Life.minutes_of`.
    """
    ends, minute = np.cumsum(life.steps()), control_steps(1)
    starts = ends - life.steps()
    return [np.arange(a // minute, -(-b // minute)) for a, b in zip(starts, ends, strict=True)]


def _recovery(scores: np.ndarray) -> np.ndarray:
    """Returns each robot's minute of recovery, see `Adaptation`, from scores of shape (n, m)."""
    minutes = scores.shape[1]
    width = min(WINDOW, minutes)
    sums = np.cumsum(np.pad(scores, ((0, 0), (1, 0))), axis=1)
    means = (sums[:, width:] - sums[:, :-width]) / width
    recovered = means >= RECOVERED
    return np.where(recovered.any(axis=1), 1.0 + recovered.argmax(axis=1), minutes)


def shares_of(run: Run, condition: Condition) -> np.ndarray:
    """Returns each robot's share of each minute at the goal, (n, M); 0 for invalid robots."""
    results = run.results[condition]
    shares = results.curves.astype(float)
    shares[[not robot.valid for robot in results.robots]] = 0
    return shares
