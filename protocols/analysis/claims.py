"""Judging claims: whether the evidence supports a sentence of the paper or contradicts it.

A claim needs one or several inequalities, each tested in both directions.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Sequence
from typing import Any, Literal

import numpy as np

from ..lives.conditions import Condition
from ..lives.learn_ability import CATEGORIES, Summary
from ..lives.run import Robot, Run
from .behaviour import Behaviour
from .hypothesis_tests import ALPHA, Sample, TestedInequality
from .paper_numbers import PAPER

Verdict = Literal["holds", "does not hold", "undecided", "not judged"]


class Undecidable(Exception):
    """The evidence is not sufficient to test a claim; the text says what is missing."""


@dataclasses.dataclass(frozen=True)
class Evidence:
    """Data by which claims are judged: a run, or the paper's own tables.

    Every method raises Undecidable where data are missing.

    Attributes:
      run: The run; None for the paper's tables, which hold no data of single robots.
      behaviour: Behaviour of the run's robots; None if they were not observed.
    """

    run: Run | None
    behaviour: Behaviour | None = None

    def summary(self, condition: Condition) -> Summary:
        """Returns a column of table 1 or 2."""
        if self.run is None:
            return PAPER[condition]
        if not self.run.valid(condition):
            raise Undecidable(f"no robots of {condition.task}, {condition.proposer}")
        return self.run.summary(condition)

    def single_robots(self) -> Run:
        """Returns the run that has the data of single robots."""
        if self.run is None:
            raise Undecidable("the paper has no data of single robots")
        return self.run

    def observed(self) -> Behaviour:
        """Returns the behaviour of the robots."""
        if self.run is None:
            raise Undecidable("the paper does not measure what the robots do")
        if self.behaviour is None:
            raise Undecidable(
                "the brains were not observed in their robots, as `musebot report` does"
            )
        return self.behaviour


def robots(evidence: Evidence, condition: Condition) -> list[Robot]:
    """Returns the valid robots of a condition.

    Raises:
      Undecidable: the condition has no valid robots.
    """
    rows = evidence.single_robots().valid(condition)
    if not rows:
        raise Undecidable(f"no robots of {condition.task}, {condition.proposer}")
    return rows


def count(evidence: Evidence, condition: Condition, category: str) -> tuple[int, int]:
    """Returns the number of a condition's robots in a category, and of all its robots."""
    summary = evidence.summary(condition)
    return summary.counts[CATEGORIES.index(category)], summary.robots


def ability(evidence: Evidence, condition: Condition) -> Sample:
    """Returns the Learn Ability L of a condition's measured robots."""
    summary = evidence.summary(condition)
    return Sample(summary.mean, summary.deviation, sum(summary.counts[:-1]))


def post_share(evidence: Evidence, condition: Condition) -> Sample:
    """Returns the share of the test after training in contact (or in the spot)."""
    robots(evidence, condition)  # refuses a condition without robots
    return Sample.of(evidence.single_robots().shares(condition, "post"))


def arrival_minutes(
    evidence: Evidence, condition: Condition, part: Literal["pre", "post"] = "post"
) -> np.ndarray:
    """Returns the minute of a test in which each robot is first in the spot.

    Args:
      evidence: Data of single robots.
      condition: Condition of the robots.
      part: The test before or after training.

    Returns:
      Index of the minute, from 0, shape (n,); NaN for robots that never arrive.

    Raises:
      Undecidable: there are no robots, or no data of the test.
    """
    robots(evidence, condition)
    run = evidence.single_robots()
    minutes = run.experiment.schedule(condition.task).minutes_of(part)
    test = run.curves(condition)[:, minutes] > 0
    if not test.shape[1]:
        raise Undecidable("the curves end before the test")
    return np.where(test.any(axis=1), test.argmax(axis=1).astype(float), np.nan)


@dataclasses.dataclass(frozen=True)
class Claim:
    """A claim of the paper: a sentence of its section 4.

    Attributes:
      task: Task of the table that the sentence is about.
      says: The sentence.
      compare: Function that tests all inequalities that the claim needs; may raise Undecidable.
    """

    task: str
    says: str
    compare: Callable[[Evidence], list[TestedInequality]]


@dataclasses.dataclass(frozen=True)
class ClaimResult:
    """The verdict on a claim.

    Attributes:
      claim: The claim.
      verdict: Whether the claim holds.
      why: Text with the numbers and the names of the tests; if data are missing for a verdict, a
        text that says which.
      inequalities: Inequalities that the verdict rests on.
      paper: Verdict on the same claim by the paper's own tables.
    """

    claim: Claim
    verdict: Verdict
    why: str
    inequalities: tuple[TestedInequality, ...] = ()
    paper: Verdict = "not judged"

    @property
    def words(self) -> str:
        """The numbers and tests, and the verdict by the paper's own tables, if there is one."""
        own = f" The paper's own numbers: {self.paper}." if self.paper != "not judged" else ""
        return f"{self.why}{own}"

    def as_json(self) -> dict[str, Any]:
        """Returns the result as plain data; NaN as None."""
        return {
            "task": self.claim.task,
            "claim": self.claim.says,
            "verdict": self.verdict,
            "why": self.why,
            "verdict_by_paper_tables": self.paper,
            "inequalities": [
                {
                    name: None if isinstance(x, float) and math.isnan(x) else x
                    for name, x in dataclasses.asdict(one).items()
                }
                for one in self.inequalities
            ],
        }


def judge(claim: Claim, evidence: Evidence) -> ClaimResult:
    """Judges a claim: it holds if all inequalities do, and fails if one fails.

    A claim holds if the tests support all its inequalities significantly; that needs no correction.
    It fails if one test contradicts its inequality significantly; the p-values against them are
    multiplied by the number of inequalities (Bonferroni). The level is two-sided: half of `ALPHA`
    for either verdict.
    """
    try:
        inequalities = tuple(claim.compare(evidence))
    except Undecidable as missing:
        return ClaimResult(claim, "not judged", f"{missing}.")
    verdict: Verdict = "undecided"
    if all(_p_for(one) < ALPHA for one in inequalities):
        verdict = "holds"
    elif any(_p_against(one, inequalities) < ALPHA for one in inequalities):
        verdict = "does not hold"
    return ClaimResult(claim, verdict, _because(inequalities), inequalities)


def _p_for(one: TestedInequality) -> float:
    """Returns the two-sided p-value in support of an inequality."""
    return min(1, 2 * one.p_for)


def _p_against(one: TestedInequality, inequalities: Sequence[TestedInequality]) -> float:
    """Returns the two-sided p-value against an inequality, times the number of inequalities."""
    return min(1, 2 * one.p_against * len(inequalities))


def _because(inequalities: tuple[TestedInequality, ...]) -> str:
    """Returns the numbers of all inequalities, then the name of each test once."""
    parts = []
    for one in inequalities:
        if math.isnan(one.p_for):
            parts.append(one.words)
            continue
        supported = one.p_for <= one.p_against
        p = _p_for(one) if supported else _p_against(one, inequalities)
        size = "p < 0.0001" if p < 1e-4 else f"p = {p:.2g}"
        parts.append(f"{one.words} ({size}{'' if supported else ' against it'})")
    tests = ", ".join(dict.fromkeys(one.test for one in inequalities))
    return f"{'; '.join(parts)}. {tests}."
