"""Claims: verdicts on robots made by hand, where everybody sees what they must be."""

import dataclasses
import math
from functools import partial

import numpy as np
from helpers import run_of_rows

from musebot.controller import BRAINS, PROPOSERS
from musebot.protocols.analysis import hypothesis_tests
from musebot.protocols.analysis.behaviour import Behaviour, Stay
from musebot.protocols.analysis.claims import Claim, Evidence, judge
from musebot.protocols.analysis.paper_claims import CLAIMS, judge_all
from musebot.protocols.pages import tables
from musebot.protocols.runs.conditions import Condition
from musebot.protocols.runs.experiment import Experiment
from musebot.protocols.runs.run import Robot
from musebot.tasks.lives import LIVES

WA, SF = "wall_avoidance", "spot_finding"
FIXED, CREATIVE = Condition(WA, "fixed"), Condition(SF, "creative")
NAMES = {"one": "L = 1", "some": "0 < L < 1", "zero": "L = 0", "less": "L < 0"}
ABILITY = {"one": 1.0, "some": 0.5, "zero": 0.0, "less": -0.5, "un": float("nan")}
YES, NO, OPEN, NEVER = "holds", "does not hold", "undecided", "not judged"


def robots(task, proposer, pre=1.0, post=1.0, **counts):
    """Returns rows of a condition, with so many robots of each category."""
    kinds = [kind for kind, count in counts.items() for _ in range(count)]
    names = NAMES | {"un": LIVES[task].unmeasured, "bad": "invalid"}
    return [
        Robot(task, proposer, 1, 0, i, pre, post, ABILITY.get(kind, math.nan), names[kind])
        for i, kind in enumerate(kinds)
    ]


def run_of(*groups, curves=None, time_scale=1.0):
    """Returns a run of some rows; curves of creative robots, or no event at all."""
    rows = [row for group in groups for row in group]
    run = run_of_rows(rows, Experiment(time_scale=time_scale), minutes=360)
    if curves is not None:
        run.results[CREATIVE] = dataclasses.replace(run.results[CREATIVE], curves=curves)
    return run


def evidence(*groups, behaviour=None, **options):
    return Evidence(run_of(*groups, **options), behaviour)


def verdict(says, given):
    found = [claim for claim in CLAIMS if says in f"{claim.task}: {claim.says}"]
    assert len(found) == 1, [c.says for c in found]
    return judge(found[0], given).verdict


# ---- Evidence made by hand ----


def three(task, category, fixed, random, creative, of=100):
    """Robots of each kind, so many of which are in a category."""
    other = "some" if category != "some" else "one"
    counts = zip(PROPOSERS, (fixed, random, creative), strict=True)
    return evidence(*(robots(task, p, **{category: n, other: of - n}) for p, n in counts))


def means(task=WA, **columns):
    return evidence(*(robots(task, proposer, **kinds) for proposer, kinds in columns.items()))


def below(spots, scale=10):
    """Robots with a mean L of 0.895 in wall avoidance, and others in spot finding."""
    kinds = {WA: {"one": 93, "less": 7}, SF: spots}
    counts = {task: {k: round(scale * n) for k, n in own.items()} for task, own in kinds.items()}
    return evidence(*(robots(t, p, **counts[t]) for t in (WA, SF) for p in PROPOSERS))


def alike(fixed, creative, of=1000):
    kinds = [{"one": ones, "less": of - ones} for ones in (fixed, creative)]
    return means(SF, fixed=kinds[0], creative=kinds[1])


def perfect(random, creative):
    """Random and creative robots, so many of which are geniuses; more creative ones have L = 1."""
    counts = {"random": {"one": 40, "un": random}, "creative": {"one": 70, "un": creative}}
    return means(**{p: own | {"some": 100 - sum(own.values())} for p, own in counts.items()})


def posts(task, *seconds):
    """Robots of each kind, whose time after training is half of a number or one and a half."""
    groups = []
    for proposer, post in zip(PROPOSERS, seconds, strict=True):
        groups += [robots(task, proposer, post=post * k, one=30) for k in (0.5, 1.5)]
    return evidence(*groups)


def spoiled(clean, touched):
    rows = robots(WA, "creative", pre=0.0, less=clean)
    return evidence(rows, robots(WA, "creative", less=touched, one=9))


def at_a_wall(*held):
    """Robots of each kind; so many are in contact for 95 % of the test, the others for less."""
    groups = []
    for proposer, count in zip(PROPOSERS, held, strict=True):
        groups.append(robots(WA, proposer, post=1140.0, less=count))
        groups.append(robots(WA, proposer, post=1139.0, less=100 - count))
    return evidence(*groups)


def stayed(count):
    rows = robots(SF, "creative", pre=1800.0, some=count)
    return evidence(rows, robots(SF, "creative", pre=1799.0, some=100 - count))


def trained(learnt, pre=1800.0):
    """Robots of which 30 stay in the spot as newborns; so many are there at training's end."""
    curves = np.zeros((60, 360))
    curves[:learnt, 240:300] = 0.5
    curves[learnt:, 60:240] = 1.0  # before the last quarter
    rows = robots(SF, "creative", pre=pre, one=30), robots(SF, "creative", pre=0.0, one=30)
    return evidence(*rows, curves=curves)


def arriving(minutes, early, never=7):
    """Robots that arrive in a minute of the test each, in minute 19, or never."""
    curves = np.zeros((len(minutes) + early + never, 360))
    for row, minute in enumerate([*minutes, *[19] * early]):
        curves[row, 300 + minute :] = 0.1
    curves[:, 299] = 1.0  # in training: no arrival in the test
    return evidence(robots(SF, "creative", one=len(curves)), curves=curves)


def later(before, after):
    curves = np.zeros((40, 360))
    curves[:, before:60] = 1.0
    if after is not None:
        curves[:20, 300 + after :] = 1.0
    return evidence(robots(SF, "creative", less=20, some=20), curves=curves)


def stay(first, last, count=20):
    """Robots with shares of following and of spinning, at first and at last."""
    wobble = np.linspace(-0.01, 0.01, count)
    following = np.stack([first[0] + wobble, last[0] - wobble / 2], axis=1)
    spinning = np.stack([first[1] + wobble, last[1] - wobble / 2], axis=1)
    found = Stay(np.ones(count, dtype=bool), following, spinning, np.zeros((0, 2)))
    return observed(stays={"creative": found})


def observed(spinning=(), rows=None, **rest):
    behaviour = Behaviour(dict(spinning), **{"stays": {}} | rest)
    return evidence(rows or robots(SF, "creative", one=9), behaviour=behaviour)


def spinning(task, lacking=None, **after):
    """Robots that spin little before training, and so much after it."""
    shares = {p: np.tile([0.2, share], (24, 1)) for p, share in after.items() if p != lacking}
    return observed({Condition(task, p): share for p, share in shares.items()})


def centre(way):
    """Twelve spinners of each kind move by a way towards the centre; twelve others do not spin."""
    conditions = [Condition(WA, proposer) for proposer in PROPOSERS]
    shares = np.repeat([[0.2, 0.9], [0.9, 0.1]], 12, axis=0)
    nearer = dict.fromkeys(conditions, np.repeat([[0.0, way], [0.0, -way]], 12, axis=0))
    return observed(dict.fromkeys(conditions, shares), nearer=nearer)


def born_spinners(pre, share=0.9):
    """Ten robots that spin from birth, and ten that do not and have another time of contact."""
    shares = np.repeat([[share, 0.0], [0.1, 0.9]], 10, axis=0)
    rows = [*robots(WA, "fixed", pre=pre, one=10), *robots(WA, "fixed", pre=1 - pre, one=10)]
    return observed({FIXED: shares}, rows)


def spinning_more(change):
    before = np.linspace(0.2, 0.4, 20)
    return observed({Condition(SF, "fixed"): np.stack([before, before + change], axis=1)})


def spinning_for(*percent):
    wobble = np.linspace(-0.2, 0.2, 20)
    shares = [np.stack([1 - wobble, x / 100 + wobble / 2], axis=1) for x in percent]
    return observed({Condition(SF, p): own for p, own in zip(PROPOSERS, shares, strict=False)})


NINETY, HALF, TENTH = ({"one": n, "less": 100 - n} for n in (90, 50, 10))
ALL_SPIN = dict.fromkeys(PROPOSERS, 0.6)
RANKS = [
    ("most geniuses", partial(three, WA, "un"), "fixed", True),
    ("fewest geniuses", partial(three, WA, "un"), "random", False),
    ("most robots with L = 1.", partial(three, WA, "one"), "creative", True),
    ("most robots with L < 0.", partial(three, WA, "less"), "creative", True),
    ("0 < L < 1.", partial(three, WA, "some"), "random", True),
    ("contact after training is the lowest", partial(posts, WA), "random", False),
    ("do not leave the wall", at_a_wall, "fixed", True),
    ("highest time in the spot", partial(posts, SF), "creative", True),
    ("fixed robots spin the most", spinning_for, "fixed", True),
]
# Evidence with which a claim holds, does not hold, is undecided, is not judged; None without one.
CASES = [
    ("best mean L", means(fixed=NINETY, random=HALF, creative=TENTH),
     means(fixed=HALF, random=NINETY, creative=TENTH),
     means(fixed=HALF, random=HALF, creative=TENTH)),
    ("best mean L", None, None, means(**dict.fromkeys(PROPOSERS, {"one": 100}))),
    ("best mean L", None, None, means(fixed={"one": 3, "un": 97}, random=HALF, creative=HALF)),
    ("had no contact", spoiled(30, 5), spoiled(5, 30), spoiled(10, 9), spoiled(0, 0)),
    ("more geniuses than random", perfect(5, 25), perfect(25, 5), perfect(5, 7)),
    ("wall_avoidance: After training most robots of each kind spin", spinning(WA, **ALL_SPIN),
     spinning(WA, **ALL_SPIN | {"random": 0.4}), None, spinning(WA, lacking="random", **ALL_SPIN)),
    ("most trained spinners come nearer", centre(0.05), centre(-0.05)),
    ("spins from birth", born_spinners(0), born_spinners(1), None, born_spinners(0, 0.5)),
    ("far below", below({"one": 10, "less": 90}), below({"one": 66.5, "less": 33.5}),  # by 0.4
     below({"one": 57, "less": 43}, 1)),
    # An inequality that cannot be tested does not save a claim that another refutes.
    ("far below", None, evidence(robots(WA, "fixed", one=3, un=97),
                                 *(robots(WA, p, **HALF) for p in ("random", "creative")),
                                 *(robots(SF, p, **HALF) for p in PROPOSERS))),
    ("about Fixed's", alike(500, 510), alike(500, 100), alike(10, 10, of=20)),
    ("about Fixed's", None, alike(100, 500)),
    ("Fewer creative than random", three(SF, "less", 0, 60, 30), three(SF, "less", 0, 30, 60),
     three(SF, "less", 0, 50, 48)),
    ("mostly ignorant", three(SF, "un", 90, 10, 10), three(SF, "un", 20, 10, 10),
     three(SF, "un", 55, 10, 10)),
    ("Random robots mostly", three(SF, "less", 0, 90, 0), three(SF, "less", 90, 9, 9)),
    ("by far", three(SF, "one", 4, 4, 30), three(SF, "one", 30, 4, 31), three(SF, "one", 4, 4, 12)),
    ("by far", None, None, three(SF, "one", 0, 0, 0)),
    ("quite a few creative robots", stayed(20), stayed(0), stayed(6)),
    ("easily trained", trained(30), trained(1), trained(15), trained(30, pre=0.0)),
    ("arrive later after training", later(2, 25), later(25, 2), later(2, 2), later(2, None)),
    ("spot_finding: After training most robots of each kind spin", spinning(SF, **ALL_SPIN),
     spinning(SF, **ALL_SPIN | {"random": 0.1})),
    ("Spinning is reinforced", spinning_more(0.3), spinning_more(-0.2)),
    ("follow the spot's contour", stay((0.8, 0.1), (0.1, 0.8)), stay((0.1, 0.8), (0.8, 0.1)),
     stay((0.5, 0.5), (0.5, 0.5)), observed()),
    ("follow the spot's contour", None, None, stay((0.8, 0.1), (0.1, 0.8), count=3)),
    ("20 to 30 minutes", arriving([20] * 40, 60), arriving([25] * 2, 60), arriving([25] * 4, 8),
     arriving([], 0)),
]  # fmt: skip


def test_a_claim_about_the_most_or_the_least():
    for says, three_kinds, proposer, most in RANKS:
        for own, expected in ((70, YES if most else NO), (5, NO if most else YES), (30, OPEN)):
            numbers = [own if other == proposer else 30 for other in PROPOSERS]
            assert verdict(says, three_kinds(*numbers)) == expected, says
            numbers[PROPOSERS.index(proposer) - 1] = own  # one other has as many
            assert verdict(says, three_kinds(*numbers)) == (NO if expected == NO else OPEN), says


def test_a_claim_has_the_verdict_that_everybody_sees():
    for says, *cases in CASES:
        for given, expected in zip(cases, (YES, NO, OPEN, NEVER), strict=False):
            assert given is None or verdict(says, given) == expected, says


EVERY = [(task, proposer) for task in (WA, SF) for proposer in PROPOSERS]
DEGENERATE = {
    "one": run_of(robots(WA, "fixed", one=1)),
    "invalid": run_of(robots(SF, "creative", bad=4)),
    "unmeasured": run_of(*(robots(t, p, un=5) for t, p in EVERY)),
    "one each": run_of(*(robots(t, p, one=1) for t, p in EVERY)),
    "all equal": run_of(*(robots(t, p, one=6) for t, p in EVERY)),
    "a minute": run_of(robots(SF, "creative", one=6), curves=np.zeros((6, 1))),
    "shortened": run_of(robots(SF, "creative", one=9), time_scale=0.01),
}


def test_every_claim_about_degenerate_runs_has_a_verdict_and_a_reason(recwarn):
    for name, given in DEGENERATE.items():
        results = judge_all(given)
        assert sum("musebot report" in result.why for result in results) == 7  # not observed
        assert {result.verdict for result in results} <= {YES, OPEN, NO, NEVER}
        assert "nan" not in tables.markdown(given), name
    assert not recwarn.list


def test_no_claim_is_judged_for_another_brain():
    run = three(WA, "one", 90, 80, 10).run
    for name in ("paper", "steady"):
        other = dataclasses.replace(run, experiment=Experiment(brain=BRAINS[name]))
        assert bool(judge_all(other)) == ("claims" in tables.markdown(other)) == (name == "paper")


def test_a_claim_of_several_inequalities_needs_more_against_one_of_them():
    one = hypothesis_tests.TestedInequality("words", "Test", 0.98, 0.02)  # two-sided: 0.04
    results = [judge(Claim(WA, "", (lambda _, n=n: [one] * n,)), Evidence(None)) for n in (1, 2)]
    assert [result.verdict for result in results] == [NO, OPEN]
    assert results[1].why == "words (p = 0.08 against it); words (p = 0.08 against it). Test."


def test_no_p_exceeds_one_and_a_number_without_a_test_is_shown_without_p():
    shown = hypothesis_tests.TestedInequality("0 of 0", "Fisher", math.nan, math.nan)
    for p_for, p_against, others, words in (
        (0.2, 0.9, [shown], "(p = 0.4); 0 of 0. Fisher."),
        (0.9, 0.7, [], "(p = 1 against it). Fisher."),
        (0.6, 0.7, [], "(p = 1). Fisher."),
    ):
        one = hypothesis_tests.TestedInequality("60 of 100", "Fisher", p_for, p_against)
        claim = Claim(WA, "", (lambda _, one=one, others=others: [one, *others],))
        assert judge(claim, Evidence(None)).why == f"60 of 100 {words}"
