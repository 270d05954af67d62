"""The inequalities of which the paper's claims consist, as functions that test them.

Each function takes what a claim is about, and returns the test of one or several inequalities.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from ...controller import PROPOSERS
from ..lives.conditions import Condition
from ..lives.learn_ability import CATEGORIES
from .claims import Evidence, Undecidable, ability, arrival_minutes, count, robots
from .hypothesis_tests import (
    Sample,
    TestedInequality,
    larger_in_pairs,
    larger_mean,
    larger_share,
    majority,
)

Compare = Callable[[Evidence], list[TestedInequality]]
Values = Callable[[Evidence, Condition], Sample]

_WALLS, _SPOT = "wall_avoidance", "spot_finding"
_NEGATIVE = CATEGORIES[3]


def ranks(condition: Condition, category: str, *, most: bool, times: float = 1) -> Compare:
    """Returns the test that a condition has the most, or the fewest, robots of a category.

    Args:
      condition: The condition.
      category: One of `CATEGORIES`.
      most: True if the condition should have the most robots, False if the fewest.
      times: Factor by which the smaller share is multiplied before the comparison.
    """

    def compare(evidence: Evidence) -> list[TestedInequality]:
        own = count(evidence, condition, category)
        found = []
        for other in _others(condition):
            theirs = count(evidence, other, category)
            words = f"{condition.proposer} {_of(own)}, {other.proposer} {_of(theirs)}"
            pair = (own, theirs) if most else (theirs, own)
            found.append(larger_share(*pair, words, times))
        return found

    return compare


def fewer(condition: Condition, other: Condition, category: str) -> Compare:
    """Returns the test that a condition has fewer robots of a category than another."""

    def compare(evidence: Evidence) -> list[TestedInequality]:
        own, theirs = (count(evidence, one, category) for one in (condition, other))
        words = f"{condition.proposer} {_of(own)}, {other.proposer} {_of(theirs)}"
        return [larger_share(theirs, own, words)]

    return compare


def both(*tests: Compare) -> Compare:
    """Returns the test of all inequalities of several tests."""
    return lambda evidence: [one for test in tests for one in test(evidence)]


def mostly(condition: Condition, category: str) -> Compare:
    """Returns the test that more than half of a condition's robots are in a category."""

    def compare(evidence: Evidence) -> list[TestedInequality]:
        members, all_robots = count(evidence, condition, category)
        words = f"{_of((members, all_robots))}, against a half"
        return [majority(members, all_robots, words)]

    return compare


def leads(values: Values, condition: Condition, what: str, *, highest: bool) -> Compare:
    """Returns the test that a condition's mean is the highest, or the lowest.

    Args:
      values: Function that returns the compared values of a condition.
      condition: The condition.
      what: Name of the compared values.
      highest: True for the highest, False for the lowest.
    """

    def compare(evidence: Evidence) -> list[TestedInequality]:
        own = values(evidence, condition)
        found = []
        for other in _others(condition):
            theirs = values(evidence, other)
            words = f"{what} {condition.proposer} {_mean(own)}, {other.proposer} {_mean(theirs)}"
            pair = (own, theirs) if highest else (theirs, own)
            found.append(larger_mean(*pair, words))
        return found

    return compare


def far_below(gap: float) -> Compare:
    """Returns the test that every mean L of spot finding is below wall avoidance's by a gap."""

    def compare(evidence: Evidence) -> list[TestedInequality]:
        found = []
        for proposer in PROPOSERS:
            walls, spot = (ability(evidence, Condition(t, proposer)) for t in (_WALLS, _SPOT))
            words = f"{proposer} {_mean(spot)} after {_mean(walls)}"
            found.append(larger_mean(walls, spot, words, gap))
        return found

    return compare


def alike(first: Condition, second: Condition, margin: float) -> Compare:
    """Returns the two one-sided tests that two mean L differ by less than a margin."""

    def compare(evidence: Evidence) -> list[TestedInequality]:
        own, theirs = ability(evidence, first), ability(evidence, second)
        words = (
            f"{first.proposer} {_mean(own)} of {own.size}, "
            f"{second.proposer} {_mean(theirs)} of {theirs.size}"
        )
        return [
            larger_mean(own, theirs, f"{words}, not {margin:g} lower", -margin),
            larger_mean(theirs, own, f"not {margin:g} higher", -margin),
        ]

    return compare


def spoiled_without_contact(condition: Condition) -> Compare:
    """Returns the test that most robots with L < 0 had no contact before training."""

    def compare(evidence: Evidence) -> list[TestedInequality]:
        pairs = zip(
            robots(evidence, condition), evidence.single_robots().classes(condition), strict=True
        )
        spoiled = [row for row, kind in pairs if kind == _NEGATIVE]
        if not spoiled:
            raise Undecidable(f"no {condition.proposer} robot has L < 0")
        clean = sum(row.t_pre_s == 0 for row in spoiled)
        return [majority(clean, len(spoiled), f"{_of((clean, len(spoiled)))}, against a half")]

    return compare


def arrive_late(condition: Condition, least: float) -> Compare:
    """Returns the test that at least a share of the arriving robots needs 20 minutes or more."""

    def compare(evidence: Evidence) -> list[TestedInequality]:
        if evidence.single_robots().experiment.time_scale != 1:
            raise Undecidable("the shortened test does not last that long")
        minutes = arrival_minutes(evidence, condition)
        arrived = minutes[~np.isnan(minutes)]
        if not len(arrived):
            raise Undecidable(f"no {condition.proposer} robot arrives")
        late, between = (arrived >= 20).sum(), ((arrived >= 20) & (arrived < 30)).sum()
        words = (
            f"of the {condition.proposer} robots that arrive {_of((int(late), len(arrived)))} need "
            f"20 minutes or more, {between} of these less than 30; the median is "
            f"{np.median(arrived):g}"
        )
        return [majority(int(late), len(arrived), words, least)]

    return compare


def stuck(condition: Condition, least: float) -> Compare:
    """Returns the test that a condition has the most robots in contact nearly all the time.

    Args:
      condition: The condition.
      least: Share of the time in the test after training.
    """

    def compare(evidence: Evidence) -> list[TestedInequality]:
        def held(one: Condition) -> tuple[int, int]:
            rows = robots(evidence, one)
            shares = evidence.single_robots().shares(one, "post")
            return int((shares >= least).sum()), len(rows)

        own, found = held(condition), []
        for other in _others(condition):
            theirs = held(other)
            words = f"{condition.proposer} {_of(own)}, {other.proposer} {_of(theirs)}"
            found.append(larger_share(own, theirs, words))
        return found

    return compare


def settlers(evidence: Evidence, condition: Condition) -> np.ndarray:
    """Returns which robots are in the spot for half of the test before training, shape (n,)."""
    robots(evidence, condition)
    return evidence.single_robots().shares(condition, "pre") >= 0.5


def settle(condition: Condition, least: float) -> Compare:
    """Returns the test that more than a share of newborns stay in the spot."""

    def compare(evidence: Evidence) -> list[TestedInequality]:
        found = settlers(evidence, condition)
        pair = int(found.sum()), len(found)
        return [majority(*pair, f"{_of(pair)}, against {least:.0%}", least)]

    return compare


def settlers_learn(condition: Condition) -> Compare:
    """Returns the test that most of `settlers` are in the spot for half of training's end."""

    def compare(evidence: Evidence) -> list[TestedInequality]:
        run, chosen = evidence.single_robots(), settlers(evidence, condition)
        if not chosen.any():
            raise Undecidable(f"no {condition.proposer} robot stays in the spot before training")
        training = run.curves(condition)[
            :, run.experiment.schedule(condition.task).minutes_of("training")
        ]
        last = training[chosen, -(training.shape[1] // 4) :].mean(axis=1) >= 0.5
        pair = int(last.sum()), int(chosen.sum())
        return [majority(*pair, f"{_of(pair)}, against a half")]

    return compare


def later(condition: Condition) -> Compare:
    """Returns the test that robots with L < 0 that arrive in both tests arrive later after it."""

    def compare(evidence: Evidence) -> list[TestedInequality]:
        worse = np.array(evidence.single_robots().classes(condition)) == _NEGATIVE
        before, after = (arrival_minutes(evidence, condition, part) for part in ("pre", "post"))
        arrived = worse & ~np.isnan(before) & ~np.isnan(after)
        if not arrived.any():
            raise Undecidable(f"no {condition.proposer} robot with L < 0 arrives in both tests")
        medians = [np.median(minutes[arrived]) for minutes in (before, after)]
        words = f"{arrived.sum()} robots: median minute {medians[0]:g} before, {medians[1]:g} after"
        return [larger_in_pairs(after[arrived], before[arrived], words)]

    return compare


def spinning(evidence: Evidence, condition: Condition) -> np.ndarray:
    """Returns the share of time in which each observed robot spins, before and after training.

    Raises:
      Undecidable: the robots were not observed.
    """
    shares = evidence.observed().spinning.get(condition)
    if shares is None or not len(shares):
        raise Undecidable(f"no robots of {condition.task}, {condition.proposer}")
    return shares


def spun(evidence: Evidence, condition: Condition) -> Sample:
    """Returns the share of time in which trained robots spin."""
    return Sample.of(spinning(evidence, condition)[:, 1])


def spin(task: str) -> Compare:
    """Returns the test that most trained robots of each kind spin more than half of the time."""

    def compare(evidence: Evidence) -> list[TestedInequality]:
        found = []
        for proposer in PROPOSERS:
            shares = spinning(evidence, Condition(task, proposer))
            spinners = int((shares[:, 1] > 0.5).sum())
            words = f"{proposer} {_of((spinners, len(shares)))}"
            found.append(majority(spinners, len(shares), words))
        return found

    return compare


def spinners_near_the_centre(task: str) -> Compare:
    """Returns the test that most trained spinners come nearer to the arena's centre meanwhile."""

    def compare(evidence: Evidence) -> list[TestedInequality]:
        nearer: list[float] = []
        for proposer in PROPOSERS:
            condition = Condition(task, proposer)
            spins = spinning(evidence, condition)[:, 1] > 0.5
            nearer += evidence.observed().nearer[condition][spins, 1].tolist()
        if not nearer:
            raise Undecidable("no robot spins")
        moved = np.array(nearer)
        pair = int((moved > 0).sum()), len(moved)
        words = f"{_of(pair)} spinners, median {np.median(moved):.3f} m, against a half"
        return [majority(*pair, words)]

    return compare


def born_spinners_touch_nothing(condition: Condition) -> Compare:
    """Returns the test that most newborns that spin have no contact before training."""

    def compare(evidence: Evidence) -> list[TestedInequality]:
        shares = spinning(evidence, condition)
        rows = robots(evidence, condition)[: len(shares)]
        clean = [
            row.t_pre_s == 0 for row, share in zip(rows, shares[:, 0], strict=True) if share > 0.5
        ]
        if not clean:
            raise Undecidable(f"no newborn {condition.proposer} robot spins")
        pair = sum(clean), len(clean)
        return [majority(*pair, f"{_of(pair)} newborn spinners, against a half")]

    return compare


def spin_more(condition: Condition) -> Compare:
    """Returns the test that robots spin more after training than before."""

    def compare(evidence: Evidence) -> list[TestedInequality]:
        shares = spinning(evidence, condition)
        before, after = shares.mean(axis=0)
        words = f"{len(shares)} robots: {before:.0%} of the time before, {after:.0%} after"
        return [larger_in_pairs(shares[:, 1], shares[:, 0], words)]

    return compare


def contour_then_spin(evidence: Evidence) -> list[TestedInequality]:
    """Tests that, over time, robots follow the spot's contour less and spin inside it more."""
    found = {who: stay for who, stay in evidence.observed().stays.items() if stay.staying.any()}
    if not found:
        raise Undecidable("no robot stays at the spot")
    stays = found.values()
    numbers = ", ".join(f"{int(stay.staying.sum())} {who}" for who, stay in found.items())
    following = np.concatenate([stay.following[stay.staying] for stay in stays])
    spinning = np.concatenate([stay.spinning[stay.staying] for stay in stays])
    (f_first, f_last), (s_first, s_last) = following.mean(axis=0), spinning.mean(axis=0)
    return [
        larger_in_pairs(
            following[:, 0],
            following[:, 1],
            f"{numbers} robots: along the contour {f_first:.0%} of the time at first, {f_last:.0%} "
            "at last",
        ),
        larger_in_pairs(
            spinning[:, 1],
            spinning[:, 0],
            f"spinning inside {s_first:.0%} at first, {s_last:.0%} at last",
        ),
    ]


def _others(condition: Condition) -> list[Condition]:
    """Returns the paper's other conditions of the same task."""
    return [Condition(condition.task, p) for p in PROPOSERS if p != condition.proposer]


def _of(pair: tuple[int, int]) -> str:
    return f"{pair[0]} of {pair[1]}"


def _mean(sample: Sample) -> str:
    return f"{sample.mean:.3f}" if sample.size else "none"
