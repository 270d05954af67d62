"""What the probes say: times to recovery, tests of arms, effects of factors, and the verdict."""

from __future__ import annotations

import dataclasses
import itertools
import math
from collections.abc import Mapping, Sequence

import numpy as np

from ...analysis import intervals
from ...analysis.hypothesis_tests import ALPHA, holm, same_mean
from ...analysis.intervals import Interval
from ...analysis.survival import Durations, log_rank, restricted
from .arms import FACTORS, FROZEN, NEWBORN, learns, pairs
from .probes import PERIODS, PROBE

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
    def spot(self) -> np.ndarray:
        """Mean share of time in the spot from the second probe after the change on, shape (N,).

        NaN where nothing was learned, or the robot was stopped.
        """
        return np.where(self.learned, self.shares[1:].mean(axis=0), np.nan)

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
      p: p of the test, Holm-corrected over the family; NaN if not tested.
      difference: Mean of the first minus that of the second.
      less_is_better: Whether a lower mean is better.
    """

    first: str
    second: str
    p: float
    difference: float
    less_is_better: bool = True

    @property
    def sign(self) -> int:
        """1 if the first is better, -1 if it is worse, 0 if that is undecided."""
        decided = not math.isnan(self.p) and self.p < ALPHA
        better = -self.difference if self.less_is_better else self.difference
        return int(np.sign(better)) if decided else 0


def compared(arms: Arms, wanted: Sequence[tuple[str, str]]) -> list[Pair]:
    """Tests the times to recovery of pairs of arms, in minutes, by the log-rank test.

    The restricted means are compared; Holm's correction over all pairs.
    """
    times = {name: arms[name].durations for pair in wanted for name in pair}
    p_values = holm(np.array([log_rank(times[a], times[b]) for a, b in wanted]))
    return [
        Pair(a, b, float(p), mean_minutes(arms[a]) - mean_minutes(arms[b]))
        for (a, b), p in zip(wanted, p_values, strict=True)
    ]


def mean_minutes(arm: Recovery) -> float:
    """Returns the restricted mean time to recovery, in minutes; NaN without robots."""
    return _known_mean(arm.minutes)


def against_newborns(arms: Arms) -> dict[str, Pair]:
    """Returns each other arm compared with the newborns; empty without newborns."""
    others = [(name, NEWBORN) for name in arms if name != NEWBORN] if NEWBORN in arms else []
    return {pair.first: pair for pair in compared(arms, others)}


def noise_pairs(arms: Arms) -> list[Pair]:
    """Returns the arms with noise compared with those that differ in noise alone, by time."""
    return compared(arms, pairs("noise", arms))


def noise_pairs_by_share(arms: Arms) -> list[Pair]:
    """Returns the same pairs compared by the share of time in the spot, see `Recovery.spot`.

    Permutation test of the same robots in pairs; Holm's correction over all pairs.
    """
    wanted = pairs("noise", arms)
    spots = [(arms[a].spot, arms[b].spot) for a, b in wanted]
    p_values = holm(np.array([same_mean(*both, paired=True) for both in spots]))
    return [
        Pair(*names, float(p), _known_mean(first - second), less_is_better=False)
        for names, (first, second), p in zip(wanted, spots, p_values, strict=True)
    ]


def _known_mean(values: np.ndarray) -> float:
    known = values[~np.isnan(values)]
    return float(known.mean()) if len(known) else math.nan


def effects(arms: Arms) -> dict[str, tuple[int, float, Interval]]:
    """Returns the main effect of each factor, and that of noise times ideas.

    An effect is the second level's restricted time minus the first's, in minutes, for each robot a
    mean over the pairs of arms that differ in the factor alone; its 95 % interval is over robots.
    Main effects leave out arms that cannot learn, see `learns`.

    Returns:
      Number of pairs of arms, mean and interval, by a description of the effect.
    """
    found = {}
    able = {name: arm for name, arm in arms.items() if learns(name)}
    for factor, levels in FACTORS.items():
        if own := pairs(factor, able):
            name = f"{factor}: {levels[1]} instead of {levels[0]}"
            differences = [arms[b].minutes - arms[a].minutes for a, b in own]
            found[name] = len(own), *_mean(differences)
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
        name = "noise x ideas: effect of quiet with own ideas, minus with random"
        found[name] = sum(map(len, by_ideas.values())), *_mean([own - random])
    return found


def _mean(differences: Sequence[np.ndarray]) -> tuple[float, Interval]:
    each = np.mean(differences, axis=0)
    each = each[~np.isnan(each)]
    return _known_mean(each), intervals.mean(each) if len(each) else intervals.UNKNOWN


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
      tested: Noise pairs, by time or by share; those with a trained memory decide.
    """
    own = [pair for pair in tested if pair.first.startswith("trained-")]
    if not own:
        return "No noise pair with a trained memory is finished."
    if not all(len(arms[name].durations) for pair in own for name in (pair.first, pair.second)):
        return "Undecided: no robot had learned."
    spared = [FROZEN] if FROZEN in arms else [n for pair in own for n in (pair.first, pair.second)]
    if all(arms[name].unharmed > 0.5 for name in spared):
        return "Undecided: the change cost most robots nothing."
    if FROZEN in arms and arms[FROZEN].durations.happened.mean() > 0.5:
        return "Undecided: most robots reach the bound without learning."
    if missing := [name for name in _needed(own) if name not in arms]:
        return f"No verdict: not finished: {', '.join(missing)}."
    signs = {pair.first: pair.sign for pair in own}
    better = {name for name, sign in signs.items() if sign > 0}
    worse = {name for name, sign in signs.items() if sign < 0}
    without = {name for name in signs if "own" in name.split("-")}
    if better == signs.keys():
        recovered = [arms[pair.second].durations.happened for pair in own]
        if all(happened.mean() < 0.5 for happened in recovered):
            return "The claim holds: noise is essential."
        return "Noise helps, but is not essential."
    if without and better == without:
        return (
            "The claim fails: noise helps only where no ideas are random, so novelty need not "
            "come from noise."
        )
    if worse and not better:
        return "The claim fails: noise hinders."
    if not worse and not better:
        return "The claim fails: noise has no detectable effect."
    named = "; ".join(
        f"{word} {', '.join(name for name in signs if name in names)}"
        for word, names in (("helps", better), ("hinders", worse))
        if names
    )
    return f"Mixed: noise {named}; no detectable effect in the other pairs."
