"""Judges claims: whether the evidence supports a sentence of the paper or contradicts it.

A claim consists of inequalities, each tested in both directions. An inequality compares a statistic
of a condition with that of another condition (`more`, `less`) or with a number (`most`), or it
compares two values of the same robots (`rises`).
"""

from __future__ import annotations

import dataclasses
import functools
import math
from collections.abc import Callable
from typing import Any, Literal, NamedTuple

from ...controller import PROPOSERS
from ..runs.conditions import Condition
from ..runs.learn_ability import Summary
from ..runs.run import Run
from .behaviour import Behaviour
from .hypothesis_tests import (
    ALPHA,
    Sample,
    Share,
    TestedInequality,
    larger_in_pairs,
    larger_mean,
    larger_share,
    majority,
)
from .paper_tables import PAPER

Verdict = Literal["holds", "does not hold", "undecided", "not judged"]


class Undecidable(Exception):
    """The evidence is not sufficient to test a claim; the text says what is missing."""


@dataclasses.dataclass(frozen=True)
class Evidence:
    """Data by which claims are judged: a run, or the paper's own tables.

    Every method raises Undecidable where data are missing.
    """

    run: Run | None  # None for the paper's tables, which hold no data of single robots
    behaviour: Behaviour | None = None  # of the run's robots; None if they were not observed

    def summary(self, condition: Condition) -> Summary:
        """Returns a condition's column of table 1 or 2."""
        return self.robots(condition).summary(condition) if self.run else PAPER[condition]

    def robots(self, condition: Condition) -> Run:
        """Returns the run, if it has valid robots of a condition."""
        if self.run is None:
            raise Undecidable("the paper has no data of single robots")
        if not self.run.valid_rows(condition):
            raise Undecidable(f"no robots of {condition.life}, {condition.proposer}")
        return self.run

    def observed(self) -> Behaviour:
        """Returns the measured behaviour of the run's robots."""
        if self.run is None:
            raise Undecidable("the paper does not measure what the robots do")
        if self.behaviour is None:
            missing = "the brains were not observed in their robots, as `musebot report` does"
            raise Undecidable(missing)
        return self.behaviour


Test = Callable[[Evidence], list[TestedInequality]]
"""A function that tests inequalities; raises Undecidable where data are missing."""


class Described(NamedTuple):
    """A `Share`, or two values of each of n robots, (2, n), and a description of this statistic."""

    value: Any
    words: str


def _ordered(
    statistic: Callable[[Evidence, Condition], Any],
    condition: Condition,
    *others: Condition,
    smaller: bool,
    what: str = "",
    times: float = 1,
) -> Test:
    """Returns the test that a share or a mean of a condition differs from that of others.

    Args:
      statistic: Function of evidence and condition that returns a `Share` or a `Sample`.
      condition: Condition whose statistic should be larger (or smaller) than that of the others.
      *others: Conditions to compare with; if none is given, those of the other two proposers.
      smaller: Whether the condition's statistic should be smaller, instead of larger.
      what: Words before the numbers in the description, such as "mean L ".
      times: Factor by which the share that should be smaller is multiplied; not used for means.
    """
    rest = [Condition(condition.life, p) for p in PROPOSERS if p != condition.proposer]

    def test(evidence: Evidence) -> list[TestedInequality]:
        own, found = statistic(evidence, condition), []
        is_mean = isinstance(own, Sample)
        larger = larger_mean if is_mean else functools.partial(larger_share, times=times)
        for other in others or rest:
            theirs = statistic(evidence, other)
            words = f"{what}{condition.proposer} {own}, {other.proposer} {theirs}"
            pair = (theirs, own) if smaller else (own, theirs)
            found.append(larger(*pair, words))
        return found

    return test


more = functools.partial(_ordered, smaller=False)
less = functools.partial(_ordered, smaller=True)


def share_above(
    border: float,
    statistic: Callable[[Evidence, Condition], Share | Described],
    *conditions: Condition,
) -> Test:
    """Returns the test that a share of robots is larger than `border` in each condition."""

    def test(evidence: Evidence) -> list[TestedInequality]:
        found = []
        for condition in conditions:
            share = statistic(evidence, condition)
            if isinstance(share, Share):
                limit = "a half" if border == 0.5 else f"{border:.0%}"
                share = Described(share, f"{share}, against {limit}")
            found.append(majority(*share, border))
        return found

    return test


most = functools.partial(share_above, 0.5)


def rises(statistic: Callable[[Evidence, Condition], Described], condition: Condition) -> Test:
    """Returns the test that the second of two values of each robot exceeds the first."""

    def test(evidence: Evidence) -> list[TestedInequality]:
        (before, after), words = statistic(evidence, condition)
        return [larger_in_pairs(after, before, words)]

    return test


class Claim(NamedTuple):
    """A sentence of the paper's section 4, and the tests of the inequalities that it needs."""

    task: str  # of the table that the sentence is about
    says: str
    tests: tuple[Test, ...]


@dataclasses.dataclass(frozen=True)
class ClaimResult:
    """The verdict on a claim, with its reasons."""

    claim: Claim
    verdict: Verdict
    why: str  # the numbers and the names of the tests; or which data are missing for a verdict
    paper: Verdict = "not judged"  # on the same claim, by the paper's own tables

    @property
    def words(self) -> str:
        """The numbers and tests, and the verdict by the paper's own tables, if there is one."""
        own = f" The paper's own numbers: {self.paper}." if self.paper != "not judged" else ""
        return f"{self.why}{own}"


def judge(claim: Claim, evidence: Evidence) -> ClaimResult:
    """Judges a claim: it holds if all inequalities do, and fails if one fails.

    A claim holds if tests support all its inequalities significantly; that needs no correction for
    several tests. It fails if a test contradicts its inequality significantly, where the p-value
    is multiplied by the number of inequalities (Bonferroni). The level is two-sided: half of
    `ALPHA` for either verdict.
    """
    try:
        inequalities = tuple(one for test in claim.tests for one in test(evidence))
    except Undecidable as missing:
        return ClaimResult(claim, "not judged", f"{missing}.")
    verdict: Verdict = "undecided"
    if all(2 * one.p_for < ALPHA for one in inequalities):
        verdict = "holds"
    elif any(2 * one.p_against * len(inequalities) < ALPHA for one in inequalities):
        verdict = "does not hold"
    return ClaimResult(claim, verdict, _because(inequalities))


def _because(inequalities: tuple[TestedInequality, ...]) -> str:
    """Returns the numbers of all inequalities, then the name of each test once."""
    parts = []
    for one in inequalities:
        if math.isnan(one.p_for):
            parts.append(one.words)
            continue
        supported = one.p_for <= one.p_against
        p = min(1, 2 * (one.p_for if supported else one.p_against * len(inequalities)))
        size = "p < 0.0001" if p < 1e-4 else f"p = {p:.2g}"
        parts.append(f"{one.words} ({size}{'' if supported else ' against it'})")
    tests = ", ".join(dict.fromkeys(one.test for one in inequalities))
    return f"{'; '.join(parts)}. {tests}."
