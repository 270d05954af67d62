"""Boards: the learners of kept runs, between a newborn and a hand-coded robot, and their ranks.

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
from ...models import Kinematics
from ..agents.names import TRAINED_BEFORE, short_name
from ..agents.senses import senses_of
from ..analysis.hypothesis_tests import holm, same_draws
from ..analysis.intervals import FEWEST
from ..errors import InputError
from ..lives.conditions import Condition
from ..lives.experiment import Body, Experiment, Signals, differing
from ..lives.overrides import brain_name, overrides_of
from ..lives.run import Run
from ..lives.schedules import TASK_NAMES

LOWER, UPPER = "newborn", "hand_coded"
DRAWS = 100_000
"""Bootstrap draws of a score: with 10,000 p of 0.05 changed by 0.01 and more with the seed."""

_BLOCK, _SEED = 5000, 1  # draws at a time, which bounds the memory
_VALUES = "after", "training"  # of whose scaled values a score is the mean
_BOTH: tuple[Signals, ...] = ("paper", "raw")
_MAY_DIFFER = ("brain", "signals", "settings", "seed", "cohort_size")  # between robots of a board
_NO_OPTIONS = "turned_start", "learn_across_placement"  # of `musebot run`: only --config has them
_HAVE_WORDS = (*_MAY_DIFFER, "kinematics")  # fields that are not simply `--field value`


@dataclasses.dataclass(frozen=True)
class Board:
    """What learners are compared in.

    Attributes:
      signals: Track: the signals and the reward that learners receive.
      protocol: Protocol of their lives.
      task: Task of their lives.
      arena_scale: Scale of the arena.
      body: Body of the robots.
    """

    signals: Signals
    protocol: str
    task: str
    arena_scale: float = 1.0
    body: Body = "mujoco"

    @property
    def ranks(self) -> bool:
        """Whether its learners are ranked: in wall avoidance most are at the ceiling."""
        return self.task != "wall_avoidance"

    @property
    def title(self) -> str:
        """Title of the board."""
        return f"{TASK_NAMES[self.task]}, protocol {self.protocol}{self._arena}, {self.track}"

    @property
    def track(self) -> str:
        """Title of all boards with these signals in this simulator."""
        simulator = "kinematic simulator" if self.body == "kinematic" else "MuJoCo"
        return f"{self.signals} signals, {simulator}"

    @property
    def column(self) -> str:
        """Head of its column in a table of all boards of a track."""
        protocol = f", protocol {self.protocol}" if self.protocol != "paper" else ""
        task = TASK_NAMES[self.task].lower() if self.ranks else "touch a wall"
        return f"{task}{protocol}{self._arena}"

    @property
    def _arena(self) -> str:
        return f", arena {self.arena_scale:g} times as large" if self.arena_scale != 1 else ""

    @property
    def name(self) -> str:
        """Name of the board's figure."""
        arena = f"-{self.arena_scale:g}" if self.arena_scale != 1 else ""
        simulator = "-kinematic" if self.body == "kinematic" else ""
        return f"{self.signals}-signals-{self.protocol}-{self.task}{arena}{simulator}"


@dataclasses.dataclass(frozen=True)
class Entry:
    """A learner on a board.

    Attributes:
      name: Name of the learner, or of its brain and proposer.
      command: Words of `musebot run` that simulate it.
      experiment: Experiment of its run.
      condition: Condition of its robots.
      after: Value of each robot in the test after training, shape (n,): share of the time in the
        spot, or without contact; 0 for a robot that was stopped.
      training: The same over all of training.
      curve: Mean value in each minute of training, shape (M,).
      abilities: Learn Ability of each valid robot; NaN without one.
    """

    name: str
    command: str
    experiment: Experiment
    condition: Condition
    after: np.ndarray
    training: np.ndarray
    curve: np.ndarray
    abilities: np.ndarray

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


Ranking = Sequence[Ranked]
"""Learners and bounds of a board, the highest score first."""


def boards(runs: Sequence[Run]) -> dict[Board, list[Entry]]:
    """Returns the entries of each board.

    Raises:
      InputError: a learner stands twice on a board, or lived in another world than the others; or a
        board lacks a bound.
    """
    found: dict[Board, list[Entry]] = {}
    for run in runs:
        experiment = run.experiment
        for condition in run.conditions():
            entry = _entry(run, condition)
            for signals in tracks(experiment, condition):
                board = Board(
                    signals,
                    experiment.protocol,
                    condition.task,
                    experiment.arena_scale,
                    experiment.body,
                )
                entries = found.setdefault(board, [])
                if entries:
                    _check_same_world(board, entries[0].experiment, experiment)
                if any(entry.name == other.name for other in entries):
                    raise InputError(f"{entry.name} stands in two runs of {board.title}")
                entries.append(entry)
    # Bounds stand in both tracks, but make no board.
    found = {b: es for b, es in found.items() if not all(e.is_bound for e in es)}
    for board, entries in found.items():
        for bound in (LOWER, UPPER):
            if bound not in {entry.name for entry in entries}:
                raise InputError(f"the runs of {board.title} hold no robots of {bound}, a bound")
    return dict(sorted(found.items(), key=lambda one: dataclasses.astuple(one[0])))


def _check_same_world(board: Board, first: Experiment, other: Experiment) -> None:
    """Raises InputError where robots of a board differ in more than what drives them."""
    for field, (a, b) in differing(first, other).items():
        if field.partition(".")[0] not in _MAY_DIFFER:
            raise InputError(f"the runs of {board.title} differ in {field}: {a} and {b}")


def tracks(experiment: Experiment, condition: Condition) -> tuple[Signals, ...]:
    """Returns the tracks in which robots stand: in both, if these give them the same."""
    if not condition.has_brain:
        bound = short_name(condition.proposer) in (LOWER, UPPER)
        return _BOTH if bound else (experiment.signals,)
    if not saturates(experiment, condition.task):
        return _BOTH
    brain = experiment.brain
    return ("raw",) if brain.raw_signals or brain.raw_reward else ("paper",)


def saturates(experiment: Experiment, task: str) -> bool:
    """Returns whether a task has signals that saturate, so that its tracks differ."""
    senses = senses_of(experiment.arena_task(task))
    return any(signal.maximal for signal in (*senses.state, senses.reward))


def _entry(run: Run, condition: Condition) -> Entry:
    experiment = run.experiment
    schedule = experiment.schedule(condition.task)
    shares = run.curves(condition)[:, schedule.minutes_of("training")].astype(float)
    tested = run.shares(condition, "post")
    if not schedule.wanted:
        shares, tested = 1 - shares, 1 - tested
    # A robot that was stopped counts as the worst, as in tuning.
    valid, robots = run.valid_rows(condition), len(run.robots(condition))
    curves, after = np.zeros((robots, shares.shape[1])), np.zeros(robots)
    curves[valid], after[valid] = shares, tested
    if condition.has_brain:
        brain, *changes = experiment.brain_name.split()
        name = f"{_learner(experiment, condition.task)}, {condition.proposer}"
        command = f"--brain {brain} --proposer {condition.proposer}"
        if changes:
            command += f" --set {' '.join(changes)}"
    else:
        name = short_name(condition.proposer)
        command = f"--agent {name}"
        if experiment.signals == "raw":
            command += " --signals raw"
        if experiment.settings:
            command += f" --agent-set {' '.join(experiment.settings)}"
    return Entry(
        name,
        f"{command} {_lives(experiment, condition, robots)}",
        experiment,
        condition,
        after,
        curves.mean(axis=1),
        curves.mean(axis=0),
        run.abilities(condition),
    )


def _learner(experiment: Experiment, task: str) -> str:
    """Returns the name of a brain; in the paper's track, that of the brain that reads raw signals.

    So `steady` has one name in both tracks, where these differ.
    """
    brain = experiment.brain
    if saturates(experiment, task) and not (brain.raw_signals or brain.raw_reward):
        raw = dataclasses.replace(brain, raw_signals=True, raw_reward=True)
        if raw in BRAINS.values():
            return brain_name(raw)
    return experiment.brain_name


def _lives(experiment: Experiment, condition: Condition, robots: int) -> str:
    """Returns the words of `musebot run` that say which lives robots live."""
    words = [
        f"--task {condition.task}",
        f"--robots {robots} --cohort-size {experiment.cohort_size}",
        f"--seed {experiment.seed}",
    ]
    for field in dataclasses.fields(Experiment):
        value = getattr(experiment, field.name)
        if field.name in _HAVE_WORDS or value == field.default:
            continue
        if field.name in _NO_OPTIONS:
            words.append(f"--config FILE with {field.name}: {value}")
        else:
            words.append(f"--{field.name.replace('_', '-')} {value}")
    kinematics = overrides_of(experiment.kinematics, Kinematics())
    return " ".join([*words, *(["--kinematics", *kinematics] if kinematics else [])])


def scores_of(entry: Entry, lower: Entry, upper: Entry) -> np.ndarray:
    """Returns each robot's score: the mean of both values, 0 like a newborn and 1 like hand-coded.

    NaN where the bounds do not differ.
    """
    parts = []
    for field in _VALUES:
        values, low, high = (getattr(one, field) for one in (entry, lower, upper))
        parts.append(_scaled(values, low.mean(), high.mean()))
    return np.mean(parts, axis=0)


def _scaled(values: np.ndarray, floor: np.ndarray, ceiling: np.ndarray) -> np.ndarray:
    """Returns values on a scale from 0 at the floor to 1 at the ceiling; NaN without a span."""
    return (values - floor) / np.where(ceiling > floor, ceiling - floor, math.nan)


def _drawn(entry: Entry) -> Iterator[np.ndarray]:
    """Yields the indices of an entry's robots in each draw, in blocks of shape (b, n).

    They depend on its name only, so that other learners of the board change nothing.
    """
    random = np.random.default_rng([_SEED, zlib.crc32(entry.name.encode())])
    robots = len(entry.after)
    for first in range(0, DRAWS, _BLOCK):
        yield random.integers(robots, size=(min(_BLOCK, DRAWS - first), robots))


def _drawn_means(bound: Entry) -> dict[str, np.ndarray]:
    """Returns the mean of each value of a bound in each draw, shape (R, 1)."""
    blocks = [
        [getattr(bound, field)[rows].mean(axis=1) for field in _VALUES] for rows in _drawn(bound)
    ]
    return dict(zip(_VALUES, np.concatenate(blocks, axis=1)[..., None], strict=True))


def _draws(
    entry: Entry, floors: dict[str, np.ndarray], ceilings: dict[str, np.ndarray]
) -> np.ndarray:
    """Returns the score of a learner in each draw, shape (R,), see `Ranked`."""
    draws, first = [], 0
    for rows in _drawn(entry):
        block = slice(first, first + len(rows))
        parts = [
            _scaled(getattr(entry, field)[rows], floors[field][block], ceilings[field][block])
            for field in _VALUES
        ]
        draws.append(_middle(np.mean(parts, axis=0)))
        first += len(rows)
    return np.concatenate(draws)


def _middle(values: np.ndarray) -> np.ndarray:
    """Returns the interquartile mean: that without the lowest and the highest quarter."""
    return stats.trim_mean(values, 0.25, axis=-1)


def ranked(entries: Sequence[Entry], draw: bool = True) -> Ranking:
    """Returns the entries with their scores, the highest first.

    Args:
      entries: Learners and bounds.
      draw: Whether robots are drawn for intervals and tests; without, each `draws` is empty.
    """
    by_name = {entry.name: entry for entry in entries}
    bounds = by_name[LOWER], by_name[UPPER]
    drawn = [_drawn_means(bound) for bound in bounds if draw]
    found = []
    for entry in entries:
        scores = scores_of(entry, *bounds)
        draws = _draws(entry, *drawn) if draw else np.empty(0)
        found.append(Ranked(entry, scores, float(_middle(scores)), draws))
    return sorted(found, key=lambda one: (-np.nan_to_num(one.score), one.entry.name))


def pair_tests(ranking: Ranking) -> np.ndarray:
    """Returns p of each pair of a board's rows, shape (n, n), Holm over all pairs of learners.

    Bootstrap tests of the difference of two scores. A permutation test would need robots of equal
    spread: it rejects true null hypotheses too often (docs/methods.md). NaN for a row with
    itself, for pairs with one that does not compete, and for groups that are too small.
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


def first_learner(ranking: Ranking) -> int:
    """Returns the row of the best learner; 0 if there is none."""
    return next((n for n, one in enumerate(ranking) if one.entry.competes), 0)
