"""What section 4 of the paper claims, and whether lives bear it out: holds, does not, undecided.

A claim is one or several comparisons. Each is a test in both directions: could the data be such
if the claim were false, and could they if it were true? Words without a number in the paper
("mostly", "far", "about", "many") have one here, said in the claim itself, and chosen before any
verdict was seen: "many" of the spoiled robots are more than half, "many" of those that arrive more
than a quarter. The paper's own tables are judged by the same tests, where they say enough: some of
its claims they leave undecided.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Sequence
from typing import Any, Literal

import numpy as np

from ..experiment.experiment import Experiment
from ..playback.observation import Behaviour
from ..results.learn_ability import CATEGORIES, PAPER, Summary
from ..results.results import Results, Robot, shares, test_seconds
from .hypothesis_tests import (
    Comparison,
    Sample,
    larger_in_pairs,
    larger_mean,
    larger_share,
    majority,
)

ALPHA = 0.05  # of a claim, two-sided: half of it to either verdict

Verdict = Literal["holds", "does not hold", "undecided", "not judged"]

PAPERS = ("fixed", "random", "creative")  # the claims are about these


class Undecidable(Exception):
    """The evidence that a claim needs is not there; the text says what is missing."""


@dataclasses.dataclass(frozen=True)
class Evidence:
    """What claims are judged by.

    Attributes:
      experiment: of the run.
      results: of the run.
      behaviour: of its brains, put back into their robots; None if nobody did.
    """

    experiment: Experiment
    results: Results
    behaviour: Behaviour | None = None

    def robots(self, task: str, proposer: str) -> list[Robot]:
        """A condition's valid lives.

        Raises:
          Undecidable: it has none.
        """
        rows = self.results.valid(task, proposer)
        if not rows:
            raise Undecidable(f"no robots of {task}, {proposer}")
        return rows

    def summary(self, task: str, proposer: str) -> Summary:
        """A condition's column of table 1 or 2.

        Raises:
          Undecidable: it has no valid lives.
        """
        self.robots(task, proposer)
        return self.results.summary(self.experiment, task, proposer)

    def count(self, task: str, proposer: str, category: str) -> tuple[int, int]:
        """How many of a condition's robots are of a category, and of how many."""
        summary = self.summary(task, proposer)
        return summary.counts[CATEGORIES.index(category)], summary.robots

    def ability(self, task: str, proposer: str) -> Sample:
        """L of a condition's measured robots."""
        summary = self.summary(task, proposer)
        return Sample(summary.mean, summary.deviation, sum(summary.counts[:-1]))

    def post_share(self, task: str, proposer: str) -> Sample:
        """The robots' shares of the test after training."""
        rows = self.robots(task, proposer)
        found = shares(rows, test_seconds(self.experiment, task), "post")
        return Sample(float(found.mean()), float(found.std(ddof=min(1, len(rows) - 1))), len(rows))

    def seen(self) -> Behaviour:
        """What the brains do in their robots.

        Raises:
          Undecidable: nobody looked.
        """
        if self.behaviour is None:
            raise Undecidable(
                "only the brains can tell, back in their robots: see `musebot report`"
            )
        return self.behaviour


class PapersOwn(Evidence):
    """The paper's tables, which say nothing of single robots."""

    def summary(self, task: str, proposer: str) -> Summary:
        """A condition's column of table 1 or 2, as printed."""
        return PAPER[task, proposer]


_PAPERS_OWN = PapersOwn(Experiment(), Results([], {}, {}))


@dataclasses.dataclass(frozen=True)
class Claim:
    """A sentence of section 4.

    Attributes:
      task: whose table it is about.
      says: the sentence.
      compare: makes the comparisons, all of which the claim needs; may raise Undecidable.
    """

    task: str
    says: str
    compare: Callable[[Evidence], list[Comparison]]


@dataclasses.dataclass(frozen=True)
class Finding:
    """What became of a claim.

    Attributes:
      claim: which.
      verdict: whether it holds.
      why: the numbers and the tests, or what is missing.
      comparisons: that it rests on.
      papers: what becomes of it by the paper's own tables.
    """

    claim: Claim
    verdict: Verdict
    why: str
    comparisons: tuple[Comparison, ...] = ()
    papers: Verdict = "not judged"

    @property
    def words(self) -> str:
        """Why, and the paper's own verdict, if there is one."""
        own = f" The paper's own numbers: {self.papers}." if self.papers != "not judged" else ""
        return f"{self.why}{own}"

    def plain(self) -> dict[str, Any]:
        """As plain data."""
        return {
            "task": self.claim.task,
            "claim": self.claim.says,
            "verdict": self.verdict,
            "why": self.why,
            "by_the_papers_numbers": self.papers,
            "comparisons": [
                {
                    name: None if isinstance(x, float) and math.isnan(x) else x
                    for name, x in dataclasses.asdict(one).items()
                }
                for one in self.comparisons
            ],
        }


def judge(claim: Claim, evidence: Evidence) -> Finding:
    """Holds if every comparison does, fails if one does, and is undecided else.

    All must be significant for a claim to hold, so that none needs a correction; one is enough
    for it to fail, so that those p values are multiplied by how many there are.
    """
    try:
        comparisons = tuple(claim.compare(evidence))
    except Undecidable as missing:
        return Finding(claim, "not judged", f"{missing}.")
    verdict: Verdict = "undecided"
    if all(_holds(one) < ALPHA for one in comparisons):
        verdict = "holds"
    elif any(_fails(one, comparisons) < ALPHA for one in comparisons):
        verdict = "does not hold"
    return Finding(claim, verdict, _because(comparisons), comparisons)


def _holds(one: Comparison) -> float:
    """The two-sided p value of a comparison that is borne out."""
    return min(1, 2 * one.p_false)


def _fails(one: Comparison, comparisons: Sequence[Comparison]) -> float:
    """The two-sided p value of its opposite, corrected for being one of several."""
    return min(1, 2 * one.p_true * len(comparisons))


def judge_all(evidence: Evidence) -> list[Finding]:
    """Judges every claim, in the paper's order; none where no lives are of the paper's kind.

    Of its kind are lives of its schedules and proposers, with its brain, no number of it changed:
    what another does neither bears out a claim nor refutes it.
    """
    experiment, lived = evidence.experiment, evidence.results.conditions()
    papers = experiment.course == "paper" and experiment.brain_name == "paper"
    if not papers or not any(one in PAPER for one in lived):
        return []
    return [
        dataclasses.replace(judge(claim, evidence), papers=judge(claim, _PAPERS_OWN).verdict)
        for claim in CLAIMS
    ]


def _because(comparisons: tuple[Comparison, ...]) -> str:
    """Numbers first, then the tests, each named once."""
    parts = []
    for one in comparisons:
        if math.isnan(one.p_false):
            parts.append(one.words)
            continue
        true = one.p_false <= one.p_true
        p = _holds(one) if true else _fails(one, comparisons)
        size = "p < 0.0001" if p < 1e-4 else f"p = {p:.2g}"
        parts.append(f"{one.words} ({size}{'' if true else ' against it'})")
    tests = ", ".join(dict.fromkeys(one.test for one in comparisons))
    return f"{'; '.join(parts)}. {tests}."


# ---- What claims are made of ----

Compare = Callable[[Evidence], list[Comparison]]


def ranks(task: str, proposer: str, category: str, *, most: bool, times: float = 1) -> Compare:
    """A condition has the most (or the fewest) robots of a category, so many times the next."""

    def compare(evidence: Evidence) -> list[Comparison]:
        own = evidence.count(task, proposer, category)
        found = []
        for other in PAPERS:
            if other != proposer:
                theirs = evidence.count(task, other, category)
                words = f"{proposer} {_of(own)}, {other} {_of(theirs)}"
                pair = (own, theirs) if most else (theirs, own)
                found.append(larger_share(*pair, words, times))
        return found

    return compare


def fewer(task: str, proposer: str, other: str, category: str) -> Compare:
    """A condition has fewer robots of a category than one other."""

    def compare(evidence: Evidence) -> list[Comparison]:
        own, theirs = (evidence.count(task, who, category) for who in (proposer, other))
        return [larger_share(theirs, own, f"{proposer} {_of(own)}, {other} {_of(theirs)}")]

    return compare


def mostly(task: str, proposer: str, category: str) -> Compare:
    """More than half of a condition's robots are of a category."""

    def compare(evidence: Evidence) -> list[Comparison]:
        count, robots = evidence.count(task, proposer, category)
        return [majority(count, robots, f"{_of((count, robots))}, against a half")]

    return compare


def leads(
    values: Callable[[Evidence, str], Sample], proposer: str, what: str, *, highest: bool
) -> Compare:
    """A condition's mean is the highest (or the lowest)."""

    def compare(evidence: Evidence) -> list[Comparison]:
        own = values(evidence, proposer)
        found = []
        for other in PAPERS:
            if other != proposer:
                theirs = values(evidence, other)
                words = f"{what} {proposer} {_mean(own)}, {other} {_mean(theirs)}"
                pair = (own, theirs) if highest else (theirs, own)
                found.append(larger_mean(*pair, words))
        return found

    return compare


def _ability(task: str) -> Callable[[Evidence, str], Sample]:
    return lambda evidence, proposer: evidence.ability(task, proposer)


def _post_share(task: str) -> Callable[[Evidence, str], Sample]:
    return lambda evidence, proposer: evidence.post_share(task, proposer)


def _means_far_below(gap: float) -> Compare:
    def compare(evidence: Evidence) -> list[Comparison]:
        found = []
        for proposer in PAPERS:
            walls = evidence.ability("wall_avoidance", proposer)
            spots = evidence.ability("spot_finding", proposer)
            words = f"{proposer} {_mean(spots)} after {_mean(walls)}"
            found.append(larger_mean(walls, spots, words, gap))
        return found

    return compare


def _means_alike(task: str, first: str, second: str, margin: float) -> Compare:
    # Two one-sided tests: neither is higher than the other by as much as the margin.
    def compare(evidence: Evidence) -> list[Comparison]:
        own, theirs = evidence.ability(task, first), evidence.ability(task, second)
        words = f"{first} {_mean(own)} of {own.size}, {second} {_mean(theirs)} of {theirs.size}"
        return [
            larger_mean(own, theirs, f"{words}, not {margin:g} lower", -margin),
            larger_mean(theirs, own, f"not {margin:g} higher", -margin),
        ]

    return compare


def _spoiled_were_clean(evidence: Evidence) -> list[Comparison]:
    rows = evidence.robots("wall_avoidance", "creative")
    spoiled = [row for row in rows if row.category == "L < 0"]
    if not spoiled:
        raise Undecidable("no creative robot has L < 0")
    clean = sum(row.t_pre_s == 0 for row in spoiled)
    return [majority(clean, len(spoiled), f"{_of((clean, len(spoiled)))}, against a half")]


def arrival_minutes(evidence: Evidence, proposer: str) -> np.ndarray:
    """When robots are in the spot for the first time in the test after training.

    Returns:
      The minute's number, from 0, shape (n,); NaN for those that never are.

    Raises:
      Undecidable: there are no robots.
    """
    task = "spot_finding"
    evidence.robots(task, proposer)
    curves = evidence.results.valid_curves(task, proposer)
    test = curves[:, evidence.experiment.schedule(task).minutes_of("post")] > 0
    if not test.shape[1]:
        raise Undecidable("the curves end before the test")
    return np.where(test.any(axis=1), test.argmax(axis=1).astype(float), np.nan)


def _arrive_late(least: float) -> Compare:
    def compare(evidence: Evidence) -> list[Comparison]:
        if evidence.experiment.time_scale != 1:
            raise Undecidable("a rehearsal's test does not last that long")
        minutes = arrival_minutes(evidence, "creative")
        arrived = minutes[~np.isnan(minutes)]
        if not len(arrived):
            raise Undecidable("no creative robot arrives")
        late, between = (arrived >= 20).sum(), ((arrived >= 20) & (arrived < 30)).sum()
        words = (
            f"of the creative that arrive {_of((int(late), len(arrived)))} need 20 minutes or "
            f"more, {between} of these less than 30; the median is {np.median(arrived):g}"
        )
        return [majority(int(late), len(arrived), words, least)]

    return compare


def _spin(task: str) -> Compare:
    def compare(evidence: Evidence) -> list[Comparison]:
        found = []
        for proposer in PAPERS:
            after = evidence.seen().spinning.get((task, proposer), np.empty((0, 2)))[:, 1]
            if not len(after):
                raise Undecidable(f"no robots of {task}, {proposer}")
            spinners = int((after > 0.5).sum())
            words = f"{proposer} {_of((spinners, len(after)))}"
            found.append(majority(spinners, len(after), words))
        return found

    return compare


def _contour_then_spin(evidence: Evidence) -> list[Comparison]:
    found = {who: stay for who, stay in evidence.seen().stays.items() if stay.staying.any()}
    if not found:
        raise Undecidable("no robot stays with the spot")
    stays = found.values()
    robots = ", ".join(f"{int(stay.staying.sum())} {who}" for who, stay in found.items())
    following, spinning = (
        np.concatenate([getattr(stay, name)[stay.staying] for stay in stays])
        for name in ("following", "spinning")
    )
    # Mean, over robots, of the share of the first and of the last part of the stay.
    (f_first, f_last), (s_first, s_last) = following.mean(axis=0), spinning.mean(axis=0)
    return [
        larger_in_pairs(
            following[:, 0],
            following[:, 1],
            f"{robots} robots: along the contour {f_first:.0%} of the time at first, {f_last:.0%} "
            "at last",
        ),
        larger_in_pairs(
            spinning[:, 1],
            spinning[:, 0],
            f"spinning inside {s_first:.0%} at first, {s_last:.0%} at last",
        ),
    ]


def _of(count: tuple[int, int]) -> str:
    return f"{count[0]} of {count[1]}"


def _mean(sample: Sample) -> str:
    return f"{sample.mean:.3f}" if sample.size else "none"


_WA, _SF = "wall_avoidance", "spot_finding"
_ONES, _POSITIVE, _, _NEGATIVE, _UNMEASURED = CATEGORIES

CLAIMS = (
    Claim(_WA, "Fixed has the most geniuses.", ranks(_WA, "fixed", _UNMEASURED, most=True)),
    Claim(_WA, "Random has the fewest geniuses.", ranks(_WA, "random", _UNMEASURED, most=False)),
    Claim(_WA, "Creative has most robots with L = 1.", ranks(_WA, "creative", _ONES, most=True)),
    Claim(
        _WA,
        "Creative has most robots with L < 0.",
        ranks(_WA, "creative", _NEGATIVE, most=True),
    ),
    Claim(
        _WA,
        "Random's contact after training is the lowest.",
        leads(_post_share(_WA), "random", "share of the time", highest=False),
    ),
    Claim(
        _WA,
        "Fixed has the best mean L.",
        leads(_ability(_WA), "fixed", "mean L", highest=True),
    ),
    Claim(
        _WA,
        "Random has the most robots with 0 < L < 1.",
        ranks(_WA, "random", _POSITIVE, most=True),
    ),
    Claim(
        _WA,
        "Many creative robots with L < 0, more than half, had no contact before training.",
        _spoiled_were_clean,
    ),
    Claim(
        _WA,
        "After training most robots of each kind spin, more than half of the test's beginning.",
        _spin(_WA),
    ),
    Claim(
        _SF,
        "All mean L are far below wall avoidance's, by more than 0.5.",
        _means_far_below(0.5),
    ),
    Claim(
        _SF,
        "Creative's mean L is about Fixed's, within 0.2.",
        _means_alike(_SF, "creative", "fixed", 0.2),
    ),
    Claim(
        _SF,
        "Fewer creative than random robots have L < 0.",
        fewer(_SF, "creative", "random", _NEGATIVE),
    ),
    Claim(_SF, "Fixed robots are mostly ignorant.", mostly(_SF, "fixed", _UNMEASURED)),
    Claim(_SF, "Random robots mostly have L < 0.", mostly(_SF, "random", _NEGATIVE)),
    Claim(
        _SF,
        "Creative has by far the most robots with L = 1, more than twice any other.",
        ranks(_SF, "creative", _ONES, most=True, times=2),
    ),
    Claim(
        _SF,
        "Creative has the highest time in the spot after training.",
        leads(_post_share(_SF), "creative", "share of the time", highest=True),
    ),
    Claim(
        _SF,
        "After training most robots of each kind spin, more than half of the test's beginning.",
        _spin(_SF),
    ),
    Claim(
        _SF,
        "Robots, all kinds together, first follow the spot's contour and later spin inside it: "
        "the first and the last third of their time there, in 20 minutes of learning.",
        _contour_then_spin,
    ),
    Claim(
        _SF,
        "In the test many creative robots take 20 to 30 minutes to arrive: 20 or more for more "
        "than a quarter of those that do.",
        _arrive_late(0.25),
    ),
)
