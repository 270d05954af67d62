"""How robots adapt in a life that changes: online score, recovery, savings, forgetting.

Everything is computed for each robot first; a newborn in the same world is the control of an old
robot after a change. The measures and their sources are in docs/lives.md.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np

from ...tasks.lives import Life, control_steps
from ..lives.conditions import Condition
from ..lives.run import Run
from .intervals import FEWEST, UNKNOWN, Interval

FAILED = 0.1
"""Online score below which a life has failed."""

RECOVERED = 0.5
"""Share of the way from the lower to the upper bound at which a robot has recovered."""

WINDOW = 5
"""Minutes over which a robot must be recovered on average; also those before and after a return."""


Newborns = Sequence[np.ndarray]
"""Minutes of recovery of the newborns in each of a life's W worlds, W arrays of shape (m,)."""


@dataclasses.dataclass(frozen=True)
class Bounds:
    """Shares of time that an untrained and an informed policy reach in each of a life's W worlds.

    Attributes:
      low: Share of time in which untrained robots reach the goal, shape (W,).
      high: Share of time in which robots with a policy made for the world reach it, shape (W,).
    """

    low: np.ndarray
    high: np.ndarray

    def of_world(self, number: int) -> Bounds:
        """Returns the bounds of a life in one of the worlds only."""
        return Bounds(self.low[[number]], self.high[[number]])


@dataclasses.dataclass(frozen=True)
class Adaptation:
    """How n robots adapted in the P phases of a life.

    Attributes:
      scores: Score in each phase: 0 at the lower bound of its world, 1 at the upper, shape (n, P).
      online: Mean score over the life, weighted by the phases' minutes, shape (n,).
      recovery: Minute of each phase, from 1, at which the first `WINDOW` minutes begin whose mean
        score is at least `RECOVERED`; the last minute if none do, shape (n, P).
      before: Score in the last `WINDOW` minutes of each phase, shape (n, P).
      after: Score in the first `WINDOW` minutes of each phase, shape (n, P).
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
            # In a rehearsal the bounds may be equal.
            own = (shares[:, minutes] - low) / (span if span > 0 else np.nan)
            ends = own[:, -WINDOW:].mean(axis=1), own[:, :WINDOW].mean(axis=1)
            parts.append((own.mean(axis=1), _recovery(own), *ends))
        scores, recovery, before, after = np.array(parts).transpose(1, 2, 0)
        minutes = np.array([phase.minutes for phase in life.phases])
        online = scores @ (minutes / minutes.sum())
        return cls(scores, online, recovery, before, after, worlds)

    @property
    def failed(self) -> np.ndarray:
        """Which lives have failed, shape (n,)."""
        return self.online < FAILED

    def worst_tenth(self) -> float:
        """Returns the mean online score of the tenth of the robots with the lowest."""
        count = -(-len(self.online) // 10)
        return float(np.sort(self.online)[:count].mean())

    def relative_recovery(self, newborns: Newborns) -> np.ndarray:
        """Returns mean recovery after each change over that of newborns in the same world.

        Below 1 the old robot is faster. Returns shape (P - 1,).
        """
        means = np.array([one.mean() for one in newborns])
        return (self.recovery.mean(axis=0) / means[self.worlds])[1:]

    def last_recovery(self, newborns: Newborns, returns: int) -> tuple[float, Interval]:
        """Returns mean relative recovery in the last phases, as many as `returns`.

        The interval is that of a percentile bootstrap over old robots, which are also the newborns
        of the first world, and over the newborns of each other world. It is unknown for few robots.
        """
        mean = float(self.relative_recovery(newborns)[-returns:].mean())
        if min(map(len, newborns)) < FEWEST:
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
        return mean, (float(low), float(high))

    def slope(self, newborns: Newborns) -> float:
        """Returns the change of log2 `relative_recovery` from one change to the next.

        Positive: recovery becomes slower with age, a loss of plasticity.
        """
        relative = np.log2(self.relative_recovery(newborns))
        return float(np.polyfit(np.arange(len(relative)), relative, 1)[0])

    def savings(self) -> float:
        """Returns by which share recovery is faster in the last visits of worlds than in the first.

        NaN where no world returns.
        """
        first, last = self._visits()
        if not first:
            return float("nan")
        earlier, later = (self.recovery[:, own].mean() for own in (first, last))
        return float(1 - later / earlier)

    def forgetting(self) -> float:
        """Returns the mean score at the end of a visit less that at the next return of its world.

        NaN where no world returns.
        """
        lost = [
            (self.before[:, left] - self.after[:, back]).mean() for left, back in self._returns()
        ]
        return float(np.mean(lost)) if lost else float("nan")

    def _returns(self) -> list[tuple[int, int]]:
        """Returns pairs of phases: a visit of a world, and the next one."""
        visits = [np.flatnonzero(self.worlds == world) for world in np.unique(self.worlds)]
        return [(int(a), int(b)) for own in visits for a, b in zip(own, own[1:], strict=False)]

    def _visits(self) -> tuple[list[int], list[int]]:
        """Returns the phases of the first and of the last visits of the worlds that return."""
        returns = self._returns()
        backs = {back for _, back in returns}
        lefts = {left for left, _ in returns}
        return sorted(lefts - backs), sorted(backs - lefts)


def minutes_of_phases(life: Life) -> list[np.ndarray]:
    """Returns the indices of each phase's minutes: those whose middle is in the phase.

    A phase of a rehearsal that has none has the minute in which its own middle is.
    """
    minute, ends = control_steps(1), np.cumsum(life.steps())
    middles = np.cumsum(life.steps_of_minutes()) - life.steps_of_minutes() / 2
    phases = np.searchsorted(ends, middles, side="right")
    found = []
    for number, (end, steps) in enumerate(zip(ends, life.steps(), strict=True)):
        own = np.flatnonzero(phases == number)
        found.append(own if own.size else np.array([(end - steps // 2 - 1) // minute]))
    return found


def _recovery(scores: np.ndarray) -> np.ndarray:
    """Returns the minute, from 1, at which recovered windows begin, for scores of shape (n, m)."""
    minutes = scores.shape[1]
    width = min(WINDOW, minutes)
    sums = np.cumsum(np.pad(scores, ((0, 0), (1, 0))), axis=1)
    means = (sums[:, width:] - sums[:, :-width]) / width
    recovered = means >= RECOVERED
    return np.where(recovered.any(axis=1), 1.0 + recovered.argmax(axis=1), minutes)


def shares_of(run: Run, condition: Condition) -> np.ndarray:
    """Returns each robot's share of each minute at the goal, (n, M); a stopped robot has 0."""
    results = run.results[condition]
    shares = results.curves.astype(float)
    shares[[not robot.valid for robot in results.robots]] = 0
    return shares
