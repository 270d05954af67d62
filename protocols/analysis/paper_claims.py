"""The claims of section 4 of the paper: sentences, statistics, conditions and directions.

The paper uses words without a number ("mostly", "far", "about", "many"). Each claim here states a
number for them. We chose the numbers before the first verdict. Nine claims were added later, one of
them (fixed robots spin the most) after we had seen its result. The same tests are applied to the
paper's own tables where these print enough data.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import Literal

import numpy as np

from ...controller import PROPOSERS
from ..runs.conditions import Condition
from ..runs.learn_ability import CATEGORIES
from ..runs.run import Run
from .behaviour import Behaviour
from .claims import (
    Claim,
    ClaimResult,
    Described,
    Evidence,
    Test,
    Undecidable,
    judge,
    less,
    more,
    most,
    rises,
    share_above,
)
from .hypothesis_tests import Sample, Share, TestedInequality, larger_in_pairs, larger_mean
from .paper_tables import PAPER

_WALLS, _SPOT = "wall_avoidance", "spot_finding"
_ONES, _POSITIVE, _, _NEGATIVE, _UNMEASURED = CATEGORIES
_FIXED_W, _RANDOM_W, _CREATIVE_W = _W = [Condition(_WALLS, p) for p in PROPOSERS]
_FIXED_S, _RANDOM_S, _CREATIVE_S = _S = [Condition(_SPOT, p) for p in PROPOSERS]


def judge_all(run: Run, behaviour: Behaviour | None = None) -> list[ClaimResult]:
    """Judges every claim, in the paper's order.

    The list is empty for a run with another brain, or with none of the paper's conditions: such a
    run neither supports nor contradicts the claims. `behaviour` is that of the run's robots, or
    None if they were not observed.
    """
    experiment = run.experiment
    comparable = experiment.brain_name == "paper"
    if not comparable or not any(condition in PAPER for condition in run.conditions()):
        return []
    own, paper = Evidence(run, behaviour), Evidence(None)
    return [
        dataclasses.replace(judge(claim, own), paper=judge(claim, paper).verdict)
        for claim in CLAIMS
    ]


def in_class(category: str) -> Callable[[Evidence, Condition], Share]:
    """Returns a statistic: the share of robots in a class of the tables, one of `CATEGORIES`."""

    def statistic(evidence: Evidence, condition: Condition) -> Share:
        summary = evidence.summary(condition)
        return Share(summary.counts[CATEGORIES.index(category)], summary.robots)

    return statistic


def held(part: Literal["pre", "post"], share: float) -> Callable[[Evidence, Condition], Share]:
    """Returns a statistic: robots in contact (or in the spot) for at least `share` of a test."""
    return lambda evidence, condition: Share.of(
        evidence.robots(condition).shares(condition, part) >= share
    )


def spoiled_without_contact(evidence: Evidence, condition: Condition) -> Share:
    """Returns the share of robots without contact before training, among those with L < 0."""
    run = evidence.robots(condition)
    spoiled = np.array(run.classes(condition)) == _NEGATIVE
    if not spoiled.any():
        raise Undecidable(f"no {condition.proposer} robot has L < 0")
    return Share.of(run.shares(condition, "pre")[spoiled] == 0)


def trained_settlers(evidence: Evidence, condition: Condition) -> Share:
    """Returns the share of robots in the spot for at least half of training's last quarter.

    Only robots in the spot for at least half of the test before training are counted.
    """
    run = evidence.robots(condition)
    chosen = run.shares(condition, "pre") >= 0.5
    if not chosen.any():
        raise Undecidable(f"no {condition.proposer} robot stays in the spot before training")
    minutes = run.experiment.life_of(condition.life).minutes_of("training")
    training = run.curves(condition)[chosen, minutes]
    return Share.of(training[:, -(training.shape[1] // 4) :].mean(axis=1) >= 0.5)


def late(evidence: Evidence, condition: Condition) -> Described:
    """Returns the share of trained robots reaching the spot that need 20 minutes or more."""
    if evidence.robots(condition).experiment.time_scale != 1:
        raise Undecidable("the shortened test does not last that long")
    minutes = arrival_minutes(evidence, condition, "post")
    minutes = minutes[~np.isnan(minutes)]
    if not len(minutes):
        raise Undecidable(f"no {condition.proposer} robot arrives")
    share, between = Share.of(minutes >= 20), ((minutes >= 20) & (minutes < 30)).sum()
    words = (
        f"of the {condition.proposer} robots that arrive {share} need 20 minutes or more, "
        f"{between} of these less than 30; the median is {np.median(minutes):g}"
    )
    return Described(share, words)


def spinning(evidence: Evidence, condition: Condition) -> np.ndarray:
    """Returns the share of time in which robots spin, before and after training, shape (n, 2)."""
    shares = evidence.observed().spinning.get(condition)
    if shares is None:
        raise Undecidable(f"no robots of {condition.life}, {condition.proposer}")
    return shares


def spinners(evidence: Evidence, condition: Condition) -> Described:
    """Returns the share of trained robots that spin for more than half of the time."""
    share = Share.of(spinning(evidence, condition)[:, 1] > 0.5)
    return Described(share, f"{condition.proposer} {share}")


def spinners_to_the_centre(evidence: Evidence, condition: Condition) -> Described:
    """Returns the share of trained spinners, of all proposers, that come nearer to the centre."""
    nearer: list[float] = []
    for one in (Condition(condition.life, proposer) for proposer in PROPOSERS):
        spins = spinning(evidence, one)[:, 1] > 0.5
        nearer += evidence.observed().nearer[one][spins, 1].tolist()
    if not nearer:
        raise Undecidable("no robot spins")
    share = Share.of(np.array(nearer) > 0)
    words = f"{share} spinners, median {np.median(nearer):.3f} m, against a half"
    return Described(share, words)


def born_spinners_without_contact(evidence: Evidence, condition: Condition) -> Described:
    """Returns the share of robots spinning before training that have no contact then."""
    spins = spinning(evidence, condition)[:, 0] > 0.5
    contact = evidence.robots(condition).shares(condition, "pre")[: len(spins)]
    if not spins.any():
        raise Undecidable(f"no newborn {condition.proposer} robot spins")
    share = Share.of(contact[spins] == 0)
    return Described(share, f"{share} newborn spinners, against a half")


def ability(evidence: Evidence, condition: Condition) -> Sample:
    """Returns the summary of L over a condition's robots that have a Learn Ability."""
    summary = evidence.summary(condition)
    return Sample(summary.mean, summary.deviation, sum(summary.counts[:-1]))


def post_share(evidence: Evidence, condition: Condition) -> Sample:
    """Returns the summary of shares of time in contact (or in the spot) after training."""
    return Sample.of(evidence.robots(condition).shares(condition, "post"))


def spun(evidence: Evidence, condition: Condition) -> Sample:
    """Returns the summary of the shares of time in which trained robots spin."""
    return Sample.of(spinning(evidence, condition)[:, 1])


def far_below(evidence: Evidence) -> list[TestedInequality]:
    """Tests that each mean L in spot finding is more than 0.5 below that in wall avoidance."""
    found = []
    for pair in zip(_W, _S, strict=True):
        walls, spot = (ability(evidence, condition) for condition in pair)
        words = f"{pair[0].proposer} {spot} after {walls}"
        found.append(larger_mean(walls, spot, words, 0.5))
    return found


def alike(evidence: Evidence) -> list[TestedInequality]:
    """Tests twice, one-sided, that Creative's and Fixed's mean L differ by less than 0.2."""
    own, theirs = ability(evidence, _CREATIVE_S), ability(evidence, _FIXED_S)
    words = f"creative {own} of {own.size}, fixed {theirs} of {theirs.size}, not 0.2 lower"
    return [
        larger_mean(own, theirs, words, -0.2),
        larger_mean(theirs, own, "not 0.2 higher", -0.2),
    ]


def arrival_minutes(
    evidence: Evidence, condition: Condition, part: Literal["pre", "post"]
) -> np.ndarray:
    """Returns the minute of a test, from 0, in which each robot is first in the spot, shape (n,).

    NaN for robots that never arrive.
    """
    run = evidence.robots(condition)
    minutes = run.experiment.life_of(condition.life).minutes_of(part)
    test = run.curves(condition)[:, minutes] > 0
    if not test.shape[1]:
        raise Undecidable("the curves end before the test")
    return np.where(test.any(axis=1), test.argmax(axis=1).astype(float), np.nan)


def arrivals(evidence: Evidence, condition: Condition) -> Described:
    """Returns the minutes of arrival in both tests, (2, n), of robots with L < 0 that arrive."""
    worse = np.array(evidence.robots(condition).classes(condition)) == _NEGATIVE
    both = np.array([arrival_minutes(evidence, condition, part) for part in ("pre", "post")])
    both = both[:, worse & ~np.isnan(both).any(axis=0)]
    if not both.size:
        raise Undecidable(f"no {condition.proposer} robot with L < 0 arrives in both tests")
    before, after = np.median(both, axis=1)
    words = f"{both.shape[1]} robots: median minute {before:g} before, {after:g} after"
    return Described(both, words)


def spun_twice(evidence: Evidence, condition: Condition) -> Described:
    """Returns the share of time in which robots spin, before and after training, shape (2, n)."""
    shares = spinning(evidence, condition)
    before, after = shares.mean(axis=0)
    words = f"{len(shares)} robots: {before:.0%} of the time before, {after:.0%} after"
    return Described(shares.T, words)


def contour_then_spin(evidence: Evidence) -> list[TestedInequality]:
    """Tests that, over time, robots follow the spot's contour less and spin inside it more."""
    found = {who: stay for who, stay in evidence.observed().stays.items() if stay.staying.any()}
    if not found:
        raise Undecidable("no robot stays at the spot")
    who = ", ".join(f"{int(stay.staying.sum())} {who}" for who, stay in found.items())
    follows = np.concatenate([stay.following[stay.staying] for stay in found.values()])
    spins = np.concatenate([stay.spinning[stay.staying] for stay in found.values()])
    (f_first, f_last), (s_first, s_last) = follows.mean(axis=0), spins.mean(axis=0)
    contour = f"along the contour {f_first:.0%} of the time at first, {f_last:.0%} at last"
    inside = f"spinning inside {s_first:.0%} at first, {s_last:.0%} at last"
    return [
        larger_in_pairs(follows[:, 0], follows[:, 1], f"{who} robots: {contour}"),
        larger_in_pairs(spins[:, 1], spins[:, 0], inside),
    ]


# ---- The claims ----

_SPINS = (
    "After training most robots of each kind spin, for more than half of the test's first minutes."
)
_Row = tuple[str, *tuple[Test, ...]]
_OF_WALLS: tuple[_Row, ...] = (
    ("Fixed has the most geniuses.", more(in_class(_UNMEASURED), _FIXED_W)),
    ("Random has the fewest geniuses.", less(in_class(_UNMEASURED), _RANDOM_W)),
    ("Creative has most robots with L = 1.", more(in_class(_ONES), _CREATIVE_W)),
    ("Creative has most robots with L < 0.", more(in_class(_NEGATIVE), _CREATIVE_W)),
    (
        "Random's contact after training is the lowest.",
        less(post_share, _RANDOM_W, what="share of the time "),
    ),
    ("Fixed has the best mean L.", more(ability, _FIXED_W, what="mean L ")),
    ("Random has the most robots with 0 < L < 1.", more(in_class(_POSITIVE), _RANDOM_W)),
    (
        "Many creative robots with L < 0, more than half, had no contact before training.",
        most(spoiled_without_contact, _CREATIVE_W),
    ),
    (
        "Creative has more geniuses than random, and more robots with L = 1.",
        less(in_class(_UNMEASURED), _RANDOM_W, _CREATIVE_W),
        less(in_class(_ONES), _RANDOM_W, _CREATIVE_W),
    ),
    (
        "After training fixed has the most robots that do not leave the wall: in contact for 95 % "
        "of the test or more.",
        more(held("post", 0.95), _FIXED_W),
    ),
    (_SPINS, most(spinners, *_W)),
    (
        "Spinning often comes with a slow movement towards the arena's centre: most trained "
        "spinners come nearer to it.",
        most(spinners_to_the_centre, _CREATIVE_W),
    ),
    (
        "A fixed robot that spins from birth is never punished: most of them have no contact.",
        most(born_spinners_without_contact, _FIXED_W),
    ),
)
_OF_SPOT: tuple[_Row, ...] = (
    ("All mean L are far below those of wall avoidance, by more than 0.5.", far_below),
    ("Creative's mean L is about Fixed's, within 0.2.", alike),
    (
        "Fewer creative than random robots have L < 0.",
        less(in_class(_NEGATIVE), _CREATIVE_S, _RANDOM_S),
    ),
    ("Fixed robots are mostly ignorant.", most(in_class(_UNMEASURED), _FIXED_S)),
    ("Random robots mostly have L < 0.", most(in_class(_NEGATIVE), _RANDOM_S)),
    (
        "Creative has by far the most robots with L = 1, more than twice any other.",
        more(in_class(_ONES), _CREATIVE_S, times=2),
    ),
    (
        "Creative has the highest time in the spot after training.",
        more(post_share, _CREATIVE_S, what="share of the time "),
    ),
    (
        "Before training quite a few creative robots, more than 5 %, stay in the spot, for half of "
        "the test or more.",
        share_above(0.05, held("pre", 0.5), _CREATIVE_S),
    ),
    (
        "Most of these are easily trained: in the spot for half of training's last quarter.",
        most(trained_settlers, _CREATIVE_S),
    ),
    (
        "Creative robots with L < 0 that arrive in both tests arrive later after training.",
        rises(arrivals, _CREATIVE_S),
    ),
    (_SPINS, most(spinners, *_S)),
    (
        "After training fixed robots spin the most: their mean share of the time is the highest.",
        more(spun, _FIXED_S, what="time spinning "),
    ),
    (
        "Spinning is reinforced: fixed robots spin more after training than before.",
        rises(spun_twice, _FIXED_S),
    ),
    (
        "Robots of all kinds together first follow the spot's contour and later spin inside it, "
        "comparing the first and the last third of their time there in 20 minutes of learning.",
        contour_then_spin,
    ),
    (
        "In the test many creative robots take 20 to 30 minutes to arrive: more than a quarter of "
        "those that arrive need 20 or more.",
        share_above(0.25, late, _CREATIVE_S),
    ),
)
CLAIMS = tuple(
    Claim(task, says, tuple(tests))
    for task, rows in ((_WALLS, _OF_WALLS), (_SPOT, _OF_SPOT))
    for says, *tests in rows
)
