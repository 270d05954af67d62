"""What the probes say: times to recovery, tests of arms, effects of factors, and the verdict."""

from __future__ import annotations

import dataclasses
import itertools
import math
from collections.abc import Mapping, Sequence

import numpy as np

from ...analysis import intervals
from ...analysis.hypothesis_tests import holm, same_mean
from ...analysis.intervals import Interval
from ...analysis.survival import Durations, log_rank, restricted
from .arms import FACTORS, FROZEN, NEWBORN, pairs
from .probes import PERIODS, PROBE

ALPHA = 0.05
END = PERIODS * PROBE.minutes  # [min]
_SHARE = 0.9  # of the reference, which is recovery
_LEARNED = 0.5  # least reference of a robot that had learned


@dataclasses.dataclass(frozen=True)
class Recovery:
    """Recovery of the robots of an arm.

    Attributes:
      shares: Share of time in the spot in the probes after the change, shape (P, N), of all robots.
      reference: Mean share in the probes before the change, shape (N,).
    """

    shares: np.ndarray
    reference: np.ndarray

    @classmethod
    def of(cls, cohorts: Sequence[tuple[np.ndarray, np.ndarray]]) -> Recovery:
        """Joins the shares of several cohorts, before and after the change."""
        before, after = zip(*cohorts, strict=True)
        return cls(np.concatenate(after, axis=1), np.concatenate(before, axis=1).mean(axis=0))

    @property
    def learned(self) -> np.ndarray:
        """Whether each robot was valid and had learned what could be lost, shape (N,)."""
        return ~np.isnan(self.shares[0]) & (self.reference >= _LEARNED)

    @property
    def durations(self) -> Durations:
        """Minutes to the recovery of the robots that had learned."""
        shares, bound = self.shares[:, self.learned], _SHARE * self.reference[self.learned]
        reached = shares >= bound
        happened = np.asarray(reached.any(axis=0))
        observed = (~np.isnan(shares)).sum(axis=0) - 1  # probes before the robot was stopped
        probes = np.where(happened, reached.argmax(axis=0), observed)
        return Durations(probes * float(PROBE.minutes), happened)

    @property
    def unharmed(self) -> float:
        """Share of the robots that had learned whose first probe was a recovery; NaN for none."""
        times = self.durations
        return float((times.happened & (times.times == 0)).mean()) if len(times) else math.nan

    @property
    def minutes(self) -> np.ndarray:
        """Minutes to recovery, at most `END`; NaN where nothing was learned, shape (N,)."""
        found = np.full(len(self.reference), np.nan)
        found[self.learned] = restricted(self.durations, END)
        return found


Arms = Mapping[str, Recovery]
"""Recovery by the name of the arm."""


@dataclasses.dataclass(frozen=True)
class Pair:
    """Two arms, compared.

    Attributes:
      first: Name of the first arm.
      second: Name of the second.
      p: p of the log-rank test, Holm-corrected over the family; NaN if not tested.
      difference: Restricted mean time of the first minus that of the second, in minutes.
    """

    first: str
    second: str
    p: float
    difference: float

    @property
    def sign(self) -> int:
        """-1 if the first is faster, 1 if it is slower, 0 if that is undecided."""
        decided = not math.isnan(self.p) and self.p < ALPHA
        return int(np.sign(self.difference)) if decided else 0


def compared(arms: Arms, wanted: Sequence[tuple[str, str]]) -> list[Pair]:
    """Tests pairs of arms by the log-rank test, corrected over all of them by Holm's method."""
    times = {name: arms[name].durations for pair in wanted for name in pair}
    p_values = holm(np.array([log_rank(times[a], times[b]) for a, b in wanted]))
    return [
        Pair(a, b, float(p), mean_minutes(arms[a]) - mean_minutes(arms[b]))
        for (a, b), p in zip(wanted, p_values, strict=True)
    ]


def mean_minutes(arm: Recovery) -> float:
    """Returns the restricted mean time to recovery, in minutes; NaN without robots."""
    times = arm.minutes[arm.learned]
    return float(times.mean()) if len(times) else math.nan


def against_newborns(arms: Arms) -> dict[str, Pair]:
    """Returns each other arm compared with the newborns; empty without newborns."""
    others = [(name, NEWBORN) for name in arms if name != NEWBORN] if NEWBORN in arms else []
    return {pair.first: pair for pair in compared(arms, others)}


def noise_pairs(arms: Arms) -> list[Pair]:
    """Returns the arms with noise compared with those that differ in noise alone."""
    return compared(arms, pairs("noise", arms))


def ends(arms: Arms, tested: Sequence[Pair]) -> list[tuple[float, float]]:
    """Returns the difference of the last probes of each pair of arms, and its p-value.

    Each is over the robots that had learned, a share of time of the first arm minus that of the
    second; permutation test of the same robots in pairs, Holm-corrected over the pairs.
    """
    found = []
    for pair in tested:
        first, second = arms[pair.first], arms[pair.second]
        kept = first.learned & second.learned & ~np.isnan(first.shares[-1] - second.shares[-1])
        last = first.shares[-1, kept], second.shares[-1, kept]
        mean = float((last[0] - last[1]).mean()) if kept.any() else math.nan
        found.append((mean, same_mean(*last, paired=True)))
    p_values = holm(np.array([p for _, p in found]))
    return [(mean, float(p)) for (mean, _), p in zip(found, p_values, strict=True)]


def effects(arms: Arms) -> dict[str, tuple[float, Interval]]:
    """Returns the main effect of each factor, and that of noise times ideas.

    An effect is the second level's restricted time minus the first's, in minutes, for each robot a
    mean over all pairs of arms that differ in the factor alone; its 95 % interval is over robots.
    """
    found = {}
    for factor, levels in FACTORS.items():
        if own := pairs(factor, arms):
            name = f"{factor}: {levels[1]} instead of {levels[0]}"
            found[name] = _mean([arms[b].minutes - arms[a].minutes for a, b in own])
    by_ideas = {
        level: [
            arms[b].minutes - arms[a].minutes
            for a, b in pairs("noise", arms)
            if level in a.split("-")
        ]
        for level in FACTORS["ideas"]
    }
    if all(by_ideas.values()):
        random, own = (np.asarray(np.mean(by_ideas[k], axis=0)) for k in FACTORS["ideas"])
        found["noise x ideas: effect of quiet with own ideas, minus with random"] = _mean(
            [own - random]
        )
    return found


def _mean(differences: Sequence[np.ndarray]) -> tuple[float, Interval]:
    each = np.mean(differences, axis=0)
    each = each[~np.isnan(each)]
    return (
        (float(each.mean()), intervals.mean(each)) if len(each) else (math.nan, intervals.UNKNOWN)
    )


def _needed(own: Sequence[Pair]) -> list[str]:
    """Returns the arms that the rule needs: with noise and without, and with both kinds of ideas.

    The clock of these is reset, and any other that is among the pairs.
    """
    clocks = sorted({"reset", *(pair.first.split("-")[-1] for pair in own)})
    levels = itertools.product(FACTORS["ideas"], clocks, FACTORS["noise"])
    return [f"trained-{noise}-{ideas}-{clock}" for ideas, clock, noise in levels]


def verdict(arms: Arms, tested: Sequence[Pair]) -> str:
    """Returns the sentence on the paper's claim that the plan's rule gives.

    Args:
      arms: Recovery by arm.
      tested: Noise pairs; those with a trained memory decide.
    """
    own = [pair for pair in tested if pair.first.startswith("trained-")]
    if not own:
        return "No noise pair with a trained memory is finished."
    if not all(len(arms[name].durations) for pair in own for name in (pair.first, pair.second)):
        return "Undecided: no robot had learned."
    spared = [FROZEN] if FROZEN in arms else [n for pair in own for n in (pair.first, pair.second)]
    if all(arms[name].unharmed > 0.5 for name in spared):
        return "Undecided: the change cost most robots nothing."
    if missing := [name for name in _needed(own) if name not in arms]:
        return f"No verdict: not finished: {', '.join(missing)}."
    signs = {pair.first: pair.sign for pair in own}
    faster = {name for name, sign in signs.items() if sign < 0}
    slower = {name for name, sign in signs.items() if sign > 0}
    without = {name for name in signs if "own" in name.split("-")}
    if faster == signs.keys():
        recovered = [arms[pair.second].durations.happened for pair in own]
        if all(happened.mean() < 0.5 for happened in recovered):
            return "The claim holds: noise is essential."
        return "Noise helps, but is not essential."
    if without and faster == without:
        return (
            "The claim fails: noise speeds recovery only where no ideas are random, so novelty "
            "need not come from noise."
        )
    if slower and not faster:
        return "The claim fails: noise hinders."
    if not slower and not faster:
        return "The claim fails: noise has no detectable effect."
    named = ", ".join(
        f"{word} with {name}"
        for word, names in (("faster", faster), ("slower", slower))
        for name in signs
        if name in names
    )
    return f"Mixed: {named}; no difference in the other pairs."
