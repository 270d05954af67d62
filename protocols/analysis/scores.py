"""How well readings of the paper explain its tables: scores, and the verdict on a choice."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any, Literal

import numpy as np
from scipy import stats

from ..lives.conditions import Condition
from ..lives.learn_ability import CATEGORIES, Summary
from ..lives.run import Run
from .paper_numbers import PAPER

Support = Literal["supported", "opposed", "undecided"]

# Standard deviations of what every reading misses: four shares, mean L, its deviation, the time.
DISCREPANCY = (0.03, 0.03, 0.03, 0.03, 0.05, 0.05, 0.02)
_CLASSES = [CATEGORIES.index(name) for name in ("L = 1", "0 < L < 1", "L < 0", "unmeasured")]
_RESAMPLES, _SEED = 2000, 1


def log_likelihood(run: Run, condition: Condition) -> float:
    """Returns the synthetic log likelihood of the paper's column, given a run's robots.

    The paper's seven numbers (four shares of classes, mean L, its deviation, the time after
    training) are normal around the run's. Their covariance is that of both groups' sampling, by
    bootstrap over the run's robots, plus `DISCREPANCY`.

    Args:
      run: The run.
      condition: A condition of the paper's tables.

    Returns:
      The log density; NaN where fewer than two robots have a Learn Ability.
    """
    kinds = np.array(run.classes(condition))
    members = np.stack([kinds == CATEGORIES[k] for k in _CLASSES], axis=1).astype(float)
    abilities, times = run.abilities(condition), run.shares(condition, "post")
    robots = len(kinds)
    random = np.random.default_rng(_SEED)
    draws = random.integers(robots, size=(_RESAMPLES, robots))
    samples = np.array([_numbers(members[d], abilities[d], times[d]) for d in draws])
    samples = samples[np.isfinite(samples).all(axis=1)]
    own = _numbers(members, abilities, times)
    if not np.isfinite(own).all() or len(samples) < _RESAMPLES / 2:
        return math.nan
    paper = PAPER[condition]
    sampling = np.cov(samples.T) * (1 + robots / paper.robots)
    spread = sampling + np.diag(np.square(DISCREPANCY))
    normal: Any = stats.multivariate_normal  # its stubs allow no matrix
    return float(normal.logpdf(_printed(paper), own, spread))


def _numbers(members: np.ndarray, abilities: np.ndarray, times: np.ndarray) -> np.ndarray:
    measured = abilities[~np.isnan(abilities)]
    mean, deviation = (
        (measured.mean(), measured.std(ddof=1)) if len(measured) > 1 else (math.nan, math.nan)
    )
    return np.array([*members.mean(axis=0), mean, deviation, times.mean()])


def _printed(summary: Summary) -> np.ndarray:
    shares = summary.shares[_CLASSES]
    return np.array([*shares, summary.mean, summary.deviation, summary.post_share])


def unmet_before(condition: Condition) -> tuple[float, float]:
    """Returns bounds of the paper's share of robots without the event before training.

    In spot finding it is known: such a robot is ignorant or has L = 1. In wall avoidance such a
    robot is a genius or has L = -1, and only L < 0 is printed.
    """
    shares = dict(zip(CATEGORIES, PAPER[condition].shares.tolist(), strict=True))
    if condition.task == "spot_finding":
        known = shares["unmeasured"] + shares["L = 1"]
        return known, known
    return shares["unmeasured"], shares["unmeasured"] + shares["L < 0"]


def newborn_score(share: float, robots: int, condition: Condition) -> float:
    """Returns -z^2 / 2 of a share of newborns without the event, z its distance to the paper's.

    Args:
      share: Share of the simulated newborns.
      robots: Number of simulated newborns.
      condition: Their condition.
    """
    nearest = float(np.clip(share, *unmet_before(condition)))
    sampling = nearest * (1 - nearest) * (1 / robots + 1 / PAPER[condition].robots)
    return -((share - nearest) ** 2) / (2 * (sampling + DISCREPANCY[0] ** 2))


def verdict(differences: Mapping[Condition, float], error: float) -> Support:
    """Returns what the tables say about a choice (docs/studies/reading.md).

    Args:
      differences: Score with the choice minus score without it, of each column of the tables.
      error: Standard error of the differences' sum.
    """
    tasks: dict[str, list[float]] = {}
    for condition, difference in differences.items():
        tasks.setdefault(condition.task, []).append(difference)
    total = sum(differences.values())
    sums = [total, *map(sum, tasks.values())]
    if len(differences) > len(tasks):  # at least one task has several columns
        sums += [total - difference for difference in differences.values()]
    if abs(total) <= 2 * error or not all(math.copysign(1, total) * one > 0 for one in sums):
        return "undecided"
    return "supported" if total > 0 else "opposed"


def main_effect(values: Sequence[float], signs: Sequence[int]) -> float:
    """Returns the mean of values at +1 minus the mean of values at -1.

    Args:
      values: Score of each combination of a design.
      signs: Value of a choice in each combination, +1 or -1.
    """
    scores, levels = np.asarray(values, dtype=float), np.asarray(signs)
    return float(scores[levels > 0].mean() - scores[levels < 0].mean())
