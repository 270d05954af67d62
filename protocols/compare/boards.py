"""Boards: the learners of some runs, between a newborn and a hand-coded robot, and their ranks.

R. Agarwal, M. Schwarzer, P. S. Castro, A. Courville and M. G. Bellemare, "Deep Reinforcement
Learning at the Edge of the Statistical Precipice", NeurIPS 2021: interquartile means.
"""

from __future__ import annotations

import dataclasses
import itertools
import math
import zlib
from collections.abc import Iterator, Sequence

import numpy as np
from scipy import stats

from ...controller import BRAINS
from ...tasks.lives import LIVES
from ..agents.names import LOWER, TRAINED_BEFORE, UPPER, run_words, short_name
from ..analysis.hypothesis_tests import holm, same_draws
from ..analysis.intervals import FEWEST
from ..errors import InputError
from ..lives.conditions import Condition
from ..lives.experiment import Body, Experiment, Signals, brain_name, differing
from ..lives.run import Run

DRAWS = 100_000
"""Bootstrap draws of a score: with 10,000 p of 0.05 changed by 0.01 and more with the seed."""

_BLOCK, _SEED = 5000, 1  # draws at a time, which bounds the memory
_VALUES = "after", "training"  # of whose scaled values a score is the mean
_DRAWN = "seed", "cohort_size"  # fields in which robots of a board may differ, too


@dataclasses.dataclass(frozen=True)
class Board:
    """What learners are compared in.

    Attributes:
      signals: Track: the signals and the reward that learners receive.
      task: Name of their life.
      body: Body of the robots.
    """

    signals: Signals
    task: str
    body: Body = "mujoco"

    @property
    def ranks(self) -> bool:
        """Whether its learners are ranked: in wall avoidance most are at the ceiling."""
        return self.task != "wall_avoidance"

    @property
    def title(self) -> str:
        return f"{LIVES[self.task].title}, {self.track}"

    @property
    def track(self) -> str:
        """Title of all boards with these signals in this simulator."""
        simulator = "kinematic simulator" if self.body == "kinematic" else "MuJoCo"
        return f"{self.signals} signals, {simulator}"

    @property
    def column(self) -> str:
        """Head of its column in a table of all boards of a track."""
        return LIVES[self.task].title.lower() if self.ranks else "touch a wall"

    @property
    def name(self) -> str:
        """Name of the board's figure."""
        simulator = "-kinematic" if self.body == "kinematic" else ""
        return f"{self.signals}-signals-{self.task}{simulator}"


@dataclasses.dataclass(frozen=True)
class Entry:
    """A learner on a board.

    Attributes:
      experiment: Experiment of its run.
      condition: Condition of its robots.
      after: Value of each robot in the test after training, shape (n,): share of the time in the
        spot, or without contact; 0 for a robot that was stopped.
      training: The same over all of training.
      curve: Mean value in each minute of training, shape (M,).
      abilities: Learn Ability of each valid robot; NaN without one.
    """

    experiment: Experiment
    condition: Condition
    after: np.ndarray
    training: np.ndarray
    curve: np.ndarray
    abilities: np.ndarray

    @property
    def name(self) -> str:
        """Name of the learner, or of its brain and proposer; `steady` has one in both tracks."""
        if not self.condition.has_brain:
            return short_name(self.condition.proposer)
        raw = dataclasses.replace(self.experiment.brain, raw_signals=True, raw_reward=True)
        brain = brain_name(raw) if raw in BRAINS.values() else self.experiment.brain_name
        return f"{brain}, {self.condition.proposer}"

    @property
    def command(self) -> str:
        """Words of `musebot run` that choose what drives the robots."""
        if self.condition.has_brain:
            brain, *changes = self.experiment.brain_name.split()
            chosen = " ".join([" --set", *(f"brain.{one}" for one in changes)]) if changes else ""
            return f"--brain {brain} --proposer {self.condition.proposer}{chosen}"
        return run_words(self.name, self.experiment.signals, self.experiment.settings)

    @property
    def world(self) -> str:
        """Fields of its experiment that say how it lived and are not the defaults."""
        fields = differing(self.experiment, Experiment())
        own = {name: value for name, (value, _) in fields.items() if not _drives(name)}
        return ", ".join(f"{name}={value}" for name, value in own.items())

    @property
    def is_bound(self) -> bool:
        """Whether it is no learner, but a bound of the board."""
        return self.name in (LOWER, UPPER)

    @property
    def competes(self) -> bool:
        """Whether it is compared with others: it learned in this life."""
        return not self.is_bound and self.name != TRAINED_BEFORE

    @property
    def stopped(self) -> int:
        """Number of robots that were stopped, because their state was not finite."""
        return len(self.after) - len(self.abilities)

    @property
    def title(self) -> str:
        """Its name in a table; in italics if it is not compared."""
        return self.name if self.competes else f"*{self.name}*"

    @property
    def touching(self) -> int:
        """Number of robots with any contact in the test after training, in wall avoidance."""
        return int((self.after < 1).sum())


@dataclasses.dataclass(frozen=True)
class Ranked:
    """A learner with its score.

    Attributes:
      entry: The learner.
      scores: Score of each of its robots, see `scores_of`, shape (n,).
      score: Their interquartile mean.
      draws: Its bootstrap distribution over the robots of the learner and of both bounds, shape
        (R,). In each draw all learners of a board have the same robots of the bounds.
    """

    entry: Entry
    scores: np.ndarray
    score: float
    draws: np.ndarray

    @property
    def interval(self) -> tuple[float, float]:
        """95 % interval of the score; NaN where the bounds do not differ in a draw."""
        low, high = np.percentile(self.draws, [2.5, 97.5])
        return float(low), float(high)


def boards(runs: Sequence[Run]) -> dict[Board, list[Entry]]:
    """Returns the entries of each board.

    Raises:
      InputError: a learner stands twice on a board, or lived in another world than the others; or a
        board lacks a bound.
    """
    found: dict[Board, list[Entry]] = {}
    for run in runs:
        for condition in run.conditions():
            entry = _entry(run, condition)
            for signals in _tracks(entry):
                own = run.experiment
                board = Board(signals, condition.task, own.body)
                entries = found.setdefault(board, [])
                for field, values in differing((entries or [entry])[0].experiment, own).items():
                    if not _drives(field) and field not in _DRAWN:
                        raise InputError(
                            f"the runs of {board.title} differ in {field}: {values[0]} and "
                            f"{values[1]}"
                        )
                if any(entry.name == other.name for other in entries):
                    raise InputError(f"{entry.name} stands in two runs of {board.title}")
                entries.append(entry)
    # Bounds stand in both tracks, but make no board.
    found = {b: es for b, es in found.items() if not all(e.is_bound for e in es)}
    for board, entries in found.items():
        for bound in (LOWER, UPPER):
            if bound not in {entry.name for entry in entries}:
                raise InputError(f"the runs of {board.title} hold no robots of {bound}, a bound")
    if not found:
        raise InputError("the runs hold no learner, only bounds")
    return dict(sorted(found.items(), key=lambda one: dataclasses.astuple(one[0])))


def _drives(field: str) -> bool:
    """Returns whether a field of an experiment is of what drives the robots."""
    return field.partition(".")[0] in ("brain", "signals", "settings")


def _tracks(entry: Entry) -> tuple[Signals, ...]:
    """Returns the tracks of a learner; bounds stand in both."""
    if entry.is_bound:
        return "paper", "raw"
    if not entry.condition.has_brain:
        return (entry.experiment.signals,)
    brain = entry.experiment.brain
    return ("raw",) if brain.raw_signals or brain.raw_reward else ("paper",)


def _entry(run: Run, condition: Condition) -> Entry:
    life = run.experiment.life_of(condition.task)
    shares = run.curves(condition)[:, life.minutes_of("training")].astype(float)
    tested = run.shares(condition, "post")
    if not life.wanted:
        shares, tested = 1 - shares, 1 - tested
    # A robot that was stopped counts as the worst, as in tuning.
    valid, robots = run.valid_rows(condition), len(run.robots(condition))
    curves, after = np.zeros((robots, shares.shape[1])), np.zeros(robots)
    curves[valid], after[valid] = shares, tested
    training, curve = curves.mean(axis=1), curves.mean(axis=0)
    return Entry(run.experiment, condition, after, training, curve, run.abilities(condition))


def scores_of(entries: Sequence[Entry], rows: Sequence[np.ndarray]) -> np.ndarray:
    """Returns the scores of a learner's robots in each draw, shape (b, n).

    A score is the mean of both values, scaled so that the mean newborn has 0 and the mean
    hand-coded robot 1. NaN where the bounds do not differ. The entries are the learner and both
    bounds; the rows are the indices of the drawn robots of each, shape (b, n).
    """
    parts = []
    for field in _VALUES:
        values, low, high = (getattr(e, field)[r] for e, r in zip(entries, rows, strict=True))
        floor, ceiling = low.mean(axis=1, keepdims=True), high.mean(axis=1, keepdims=True)
        span = np.where(ceiling > floor, ceiling - floor, math.nan)
        parts.append((values - floor) / span)
    return np.mean(parts, axis=0)


def _drawn(entry: Entry) -> Iterator[np.ndarray]:
    """Yields the indices of an entry's robots in each draw, in blocks of shape (b, n).

    They depend on its name only, so that other learners of the board change nothing.
    """
    random = np.random.default_rng([_SEED, zlib.crc32(entry.name.encode())])
    robots = len(entry.after)
    for first in range(0, DRAWS, _BLOCK):
        yield random.integers(robots, size=(min(_BLOCK, DRAWS - first), robots))


def _middle(values: np.ndarray) -> np.ndarray:
    """Returns the interquartile mean: that without the lowest and the highest quarter."""
    return stats.trim_mean(values, 0.25, axis=-1)


def ranked(entries: Sequence[Entry]) -> list[Ranked]:
    """Returns learners and bounds with their scores, the highest first."""
    by_name = {entry.name: entry for entry in entries}
    found = []
    for entry in entries:
        three = entry, by_name[LOWER], by_name[UPPER]
        blocks = zip(*map(_drawn, three), strict=True)
        draws = np.concatenate([_middle(scores_of(three, rows)) for rows in blocks])
        scores = scores_of(three, [np.arange(len(one.after))[None] for one in three])[0]
        found.append(Ranked(entry, scores, float(_middle(scores)), draws))
    return sorted(found, key=lambda one: (-np.nan_to_num(one.score), one.entry.name))


def pair_tests(ranking: Sequence[Ranked]) -> np.ndarray:
    """Returns p of each pair of a board's rows, shape (n, n), Holm over all pairs of learners.

    Bootstrap tests of the difference of two scores. A permutation test would need robots of equal
    spread: it rejects true null hypotheses too often. NaN for a row with itself, for pairs with one
    that does not compete, and for groups that are too small.
    """
    learners = [n for n, one in enumerate(ranking) if one.entry.competes]
    pairs = list(itertools.combinations(learners, 2))
    values = [
        same_draws(ranking[a].draws, ranking[b].draws)
        if min(len(ranking[n].scores) for n in (a, b)) >= FEWEST
        else math.nan
        for a, b in pairs
    ]
    found = np.full((len(ranking), len(ranking)), math.nan)
    for (a, b), p in zip(pairs, holm(np.array(values)), strict=True):
        found[a, b] = found[b, a] = p
    return found


def first_learner(ranking: Sequence[Ranked]) -> int:
    """Returns the row of the best learner; 0 if there is none."""
    return next((n for n, one in enumerate(ranking) if one.entry.competes), 0)
