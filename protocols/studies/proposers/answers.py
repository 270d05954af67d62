"""What the cells answer: comparisons with today's way, contrasts, and the plan's decisions."""

from __future__ import annotations

import dataclasses
import math
from collections import Counter
from collections.abc import Container, Mapping, Sequence

import numpy as np

from ...analysis import intervals
from ...analysis.hypothesis_tests import (
    ALPHA,
    Sample,
    TestedInequality,
    holm,
    larger_mean,
    linear_contrast,
    same_mean,
)
from ...analysis.intervals import Interval
from .cells import IDEAS, WAYS, Cell

Groups = Mapping[Cell, np.ndarray]
"""Share of time with the event in the test after training of each robot, by cell, shape (n,); NaN
for a robot whose simulation became unstable. Robots with the same number were born alike, but for
the ways that are not `Way.born_alike`."""

MARGIN = 0.05  # by which the rule may be worse
_TODAY = "connections"

_Weights = Sequence[tuple[str, bool, float]]  # way, outside ideas, weight; a mean over `IDEAS`

_CONTRASTS: Mapping[str, _Weights] = {
    "memory": [("connections", True, 0.5), ("copies", True, 0.5)]
    + [("untrained", True, -0.5), ("untrained-copies", True, -0.5)],
    "noise": [("connections", True, 0.5), ("untrained", True, 0.5)]
    + [("copies", True, -0.5), ("untrained-copies", True, -0.5)],
    "memory x noise": [("connections", True, 1), ("untrained", True, -1)]
    + [("copies", True, -1), ("untrained-copies", True, 1)],
    "noise x outside ideas": [("connections", True, 1), ("copies", True, -1)]
    + [("connections", False, -1), ("copies", False, 1)],
    "main idea included": [("with-main-idea", False, 1), ("connections", False, -1)],
    "source of novelty": [("with-main-idea", False, 1), ("main-idea-uniform", False, -1)],
    "place of the noise": [("connections", False, 1), ("action", False, -1)],
    "memory against Sobol": [("connections", False, 1), ("sobol", False, -1)],
    "memory against cross-entropy": [("connections", False, 1), ("cross-entropy", False, -1)],
    "memory against the learned": [("connections", False, 1), ("learned", False, -1)],
}


@dataclasses.dataclass(frozen=True)
class Answer:
    """A difference, tested.

    Attributes:
      value: Difference of shares, or the contrast of several.
      interval: Its 95 % interval.
      p: Two-sided p-value, Holm-corrected over the family; NaN if not tested.
    """

    value: float
    interval: Interval
    p: float

    @property
    def sign(self) -> int:
        """1 or -1 where the value differs from 0 after the correction, else 0."""
        return 0 if math.isnan(self.p) or self.p >= ALPHA else int(math.copysign(1, self.value))


def baseline(cell: Cell, known: Container[Cell]) -> Cell | None:
    """Returns today's way with equally many ideas; None if it is not among the known cells.

    Its share of outside ideas is the same, unless that share makes no difference to the cell.
    """
    if cell.way == _TODAY:
        return None
    shares = (cell.outside,) if WAYS[cell.way].mixes else (cell.outside, not cell.outside)
    found = (Cell(_TODAY, cell.ideas, outside) for outside in shares)
    return next((today for today in found if today in known), None)


def compared(groups: Groups) -> dict[Cell, Answer]:
    """Returns of each cell its difference from today's way; all p-values are corrected together."""
    pairs = {cell: today for cell in groups if (today := baseline(cell, groups))}
    found = {}
    for cell, today in pairs.items():
        paired = WAYS[cell.way].born_alike
        ours, other = groups[cell], groups[today]
        if paired:
            ours, other = _same_robots([ours, other])
        span = intervals.difference_of_means(ours, other, paired, intervals.SHARE)
        value = Sample.of(ours).mean - Sample.of(other).mean
        found[cell] = Answer(value, span, same_mean(ours, other, paired))
    return _corrected(found)


def measured(values: np.ndarray) -> np.ndarray:
    """Returns the values of the valid robots."""
    return values[~np.isnan(values)]


def _same_robots(groups: Sequence[np.ndarray]) -> list[np.ndarray]:
    """Returns the values of the robots that are valid in all groups."""
    robots = min(map(len, groups))
    values = np.stack([group[:robots] for group in groups])
    return [*values[:, ~np.isnan(values).any(axis=0)]]


def contrasts(groups: Groups) -> dict[str, Answer]:
    """Returns the plan's contrasts; those of cells that are missing have no value."""
    found = {name: _contrast(groups, weights) for name, weights in _all_weights().items()}
    return _corrected(found)


def _all_weights() -> dict[str, Counter[Cell]]:
    means = {
        name: _summed([(Cell(way, n, out), w / len(IDEAS)) for n in IDEAS for way, out, w in parts])
        for name, parts in _CONTRASTS.items()
    }
    few, many = IDEAS[0], IDEAS[-1]
    means["noise x ideas"] = _summed(
        [
            (Cell(way, ideas, True), sign * weight)
            for ideas, sign in ((few, 1.0), (many, -1.0))
            for way, weight in (("connections", 1.0), ("copies", -1.0))
        ]
    )
    return means


def _summed(parts: Sequence[tuple[Cell, float]]) -> Counter[Cell]:
    """Returns the weights of simulated cells: one cell may stand for several."""
    weights: Counter[Cell] = Counter()
    for cell, weight in parts:
        weights[cell.simulated] += weight  # type: ignore[assignment]
    return weights


def _contrast(groups: Groups, weights: Mapping[Cell, float]) -> Answer:
    if not weights.keys() <= groups.keys():
        return Answer(float("nan"), intervals.UNKNOWN, float("nan"))
    own = _same_robots([groups[cell] for cell in weights])
    return Answer(*linear_contrast(own, [*weights.values()]))


def _corrected(found: Mapping) -> dict:
    p_values = holm(np.array([answer.p for answer in found.values()]))
    return {
        name: dataclasses.replace(answer, p=float(p))
        for (name, answer), p in zip(found.items(), p_values, strict=True)
    }


def decisions(groups: Groups) -> list[str]:
    """Returns the plan's decisions in sentences; empty until all their cells are finished.

    Whether only distinct candidates pay is decided by corrected p of cells, and by the uncorrected
    p of one contrast, which is in no family.
    """
    cells, effects = compared(groups), contrasts(groups)
    finished = not any(math.isnan(one.value) for one in effects.values())
    if not finished or not {Cell("uniform", ideas) for ideas in IDEAS} <= cells.keys():
        return []
    memory_at_3 = cells[Cell("uniform", IDEAS[0])].sign < 0  # uniform ideas are worse
    sentences = [
        _sentence("Noise pays", effects["noise"].sign > 0),
        _sentence("The memory pays", effects["memory"].sign > 0 and memory_at_3),
    ]
    for ideas in IDEAS:
        noise, over_uniform = (
            cells[cell].sign < 0 for cell in (Cell("copies", ideas, True), Cell("uniform", ideas))
        )
        source = _contrast(
            groups, {Cell("with-main-idea", ideas): 1.0, Cell("main-idea-uniform", ideas): -1.0}
        )
        only = noise and not over_uniform and not source.sign > 0
        sentences.append(_sentence(f"At {ideas} ideas only distinct candidates pay", only))
    return sentences


def _sentence(claim: str, holds: bool) -> str:
    return f"{claim}: {'yes' if holds else 'no'}."


def rule(groups: Groups) -> list[TestedInequality]:
    """Tests that the one-fifth rule is not worse than constant noise or no noise by `MARGIN`.

    Empty until all cells are finished. All must hold (intersection-union, no correction).
    """
    wanted = [
        (Cell("success-rule", ideas, True), Cell(other, ideas, True))
        for ideas in IDEAS
        for other in ("connections", "copies")
    ]
    if not {cell for pair in wanted for cell in pair} <= groups.keys():
        return []
    return [
        larger_mean(
            Sample.of(groups[ours]),
            Sample.of(groups[other]),
            f"{ours.ideas} ideas, {ours.way} against {other.way}",
            -MARGIN,
        )
        for ours, other in wanted
    ]
