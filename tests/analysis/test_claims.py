"""Claims: verdicts on lives made by hand, where everybody sees what they must be."""

import dataclasses
import json
import math

import numpy as np
import pytest

from musebot.controller import BRAINS
from musebot.protocols.analysis import claims
from musebot.protocols.analysis import hypothesis_tests as comparisons
from musebot.protocols.analysis.claims import CLAIMS, Claim, Evidence, judge, judge_all
from musebot.protocols.experiment.experiment import Experiment
from musebot.protocols.experiment.schedules import SCHEDULES
from musebot.protocols.playback.observation import Behaviour, Stay
from musebot.protocols.reporting import tables
from musebot.protocols.results.results import Results, Robot

WA, SF = "wall_avoidance", "spot_finding"
NAMES = {"one": "L = 1", "some": "0 < L < 1", "zero": "L = 0", "less": "L < 0"}
ABILITY = {"one": 1.0, "some": 0.5, "zero": 0.0, "less": -0.5, "un": float("nan")}


def robots(task, proposer, pre=1.0, post=1.0, **counts):
    """Rows of a condition: so many robots of each category."""
    kinds = [kind for kind, count in counts.items() for _ in range(count)]
    names = NAMES | {"un": SCHEDULES[task].unmeasured, "bad": "invalid"}
    return [
        Robot(task, proposer, 1, 0, i, pre, post, ABILITY.get(kind, math.nan), names[kind])
        for i, kind in enumerate(kinds)
    ]


def evidence(*groups, curves=None, behaviour=None, time_scale=1.0):
    rows = [row for group in groups for row in group]
    names = {f"{row.task}/{row.proposer}" for row in rows}
    minutes = {WA: 160, SF: 360}
    made = {
        n: np.zeros((sum(f"{r.task}/{r.proposer}" == n for r in rows), minutes[n.split("/")[0]]))
        for n in names
    }
    return Evidence(
        Experiment(time_scale=time_scale), Results(rows, made | (curves or {}), {}), behaviour
    )


def verdict(says, given):
    found = [claim for claim in CLAIMS if says in f"{claim.task}: {claim.says}"]
    assert len(found) == 1, [c.says for c in found]
    return judge(found[0], given).verdict


def three(task, category, fixed, random, creative, of=100):
    other = "some" if category != "some" else "one"
    return evidence(
        *(
            robots(task, proposer, **{category: n, other: of - n})
            for proposer, n in zip(claims.PAPERS, (fixed, random, creative), strict=True)
        )
    )


@pytest.mark.parametrize(
    ("says", "task", "category", "counts", "expected"),
    [
        ("most geniuses", WA, "un", (40, 10, 12), "holds"),
        ("most geniuses", WA, "un", (10, 10, 40), "does not hold"),
        ("most geniuses", WA, "un", (20, 10, 19), "undecided"),
        ("fewest geniuses", WA, "un", (40, 5, 30), "holds"),
        ("fewest geniuses", WA, "un", (5, 30, 30), "does not hold"),
        ("fewest geniuses", WA, "un", (40, 10, 10), "undecided"),
        ("most robots with L = 1.", WA, "one", (40, 30, 70), "holds"),
        ("most robots with L = 1.", WA, "one", (70, 30, 40), "does not hold"),
        ("most robots with L < 0.", WA, "less", (5, 5, 30), "holds"),
        ("most robots with L < 0.", WA, "less", (5, 5, 6), "undecided"),
        ("0 < L < 1.", WA, "some", (5, 40, 10), "holds"),
        ("0 < L < 1.", WA, "some", (5, 10, 40), "does not hold"),
        ("Fewer creative than random", SF, "less", (0, 60, 30), "holds"),
        ("Fewer creative than random", SF, "less", (0, 30, 60), "does not hold"),
        ("Fewer creative than random", SF, "less", (0, 50, 48), "undecided"),
        ("mostly ignorant", SF, "un", (90, 10, 10), "holds"),
        ("mostly ignorant", SF, "un", (20, 10, 10), "does not hold"),
        ("mostly ignorant", SF, "un", (55, 10, 10), "undecided"),
        ("Random robots mostly", SF, "less", (0, 90, 0), "holds"),
        ("by far", SF, "one", (4, 4, 30), "holds"),
        ("by far", SF, "one", (30, 4, 31), "does not hold"),
        ("by far", SF, "one", (4, 4, 12), "undecided"),
        ("by far", SF, "one", (0, 0, 0), "undecided"),
    ],
)
def test_claims_about_categories(says, task, category, counts, expected):
    assert verdict(says, three(task, category, *counts)) == expected


@pytest.mark.parametrize(
    ("fixed", "random", "creative", "expected"),
    [
        ({"one": 90, "less": 10}, {"one": 50, "less": 50}, {"one": 40, "less": 60}, "holds"),
        ({"one": 40, "less": 60}, {"one": 90, "less": 10}, {"one": 5, "less": 95}, "does not hold"),
        ({"one": 61, "less": 39}, {"one": 60, "less": 40}, {"one": 10, "less": 90}, "undecided"),
        ({"one": 3, "un": 97}, {"one": 60, "less": 40}, {"one": 60, "less": 40}, "undecided"),
        ({"one": 100}, {"one": 100}, {"one": 100}, "undecided"),
    ],
)
def test_fixed_has_the_best_mean_ability(fixed, random, creative, expected):
    columns = {"fixed": fixed, "random": random, "creative": creative}
    given = evidence(*(robots(WA, proposer, **kinds) for proposer, kinds in columns.items()))
    assert verdict("best mean L", given) == expected


def test_one_comparison_too_few_robots_allow_does_not_save_a_claim_that_another_refutes():
    few, rest = robots(WA, "fixed", one=3, un=97), {"one": 60, "less": 40}
    spots = [robots(SF, proposer, **rest) for proposer in claims.PAPERS]
    walls = [few, *(robots(WA, proposer, **rest) for proposer in ("random", "creative"))]
    assert verdict("far below", evidence(*walls, *spots)) == "does not hold"


@pytest.mark.parametrize(
    ("spots", "expected"),
    [
        ({"one": 10, "less": 90}, "holds"),
        ({"one": 80, "less": 20}, "does not hold"),
        ({"one": 57, "less": 43}, "undecided"),
    ],
)
def test_spot_findings_means_are_far_below(spots, expected):
    walls = {"one": 93, "less": 7}
    given = [robots(t, p, **k) for t, k in ((WA, walls), (SF, spots)) for p in claims.PAPERS]
    assert verdict("far below", evidence(*given)) == expected


@pytest.mark.parametrize(
    ("fixed", "creative", "expected"),
    [
        ({"one": 500, "less": 500}, {"one": 510, "less": 490}, "holds"),
        ({"one": 500, "less": 500}, {"one": 100, "less": 900}, "does not hold"),
        ({"one": 100, "less": 900}, {"one": 500, "less": 500}, "does not hold"),
        ({"one": 10, "less": 10}, {"one": 10, "less": 10}, "undecided"),
    ],
)
def test_two_means_are_alike_only_where_both_differences_are_ruled_out(fixed, creative, expected):
    given = evidence(robots(SF, "fixed", **fixed), robots(SF, "creative", **creative))
    assert verdict("about Fixed's", given) == expected


def scattered(task, proposer, post, count=60):
    """Robots whose time after training is about `post` seconds, half of it and one and a half."""
    rows = robots(task, proposer, one=count)
    return [
        Robot(r.task, r.proposer, 1, 0, r.robot, 1.0, post * (0.5 + i % 2), 1.0, "L = 1")
        for i, r in enumerate(rows)
    ]


@pytest.mark.parametrize(
    ("says", "task", "posts", "expected"),
    [
        ("lowest", WA, (100, 10, 200), "holds"),
        ("lowest", WA, (10, 100, 200), "does not hold"),
        ("lowest", WA, (100, 100, 200), "undecided"),
        ("highest time", SF, (10, 10, 100), "holds"),
        ("highest time", SF, (200, 10, 100), "does not hold"),
        ("highest time", SF, (100, 10, 100), "undecided"),
    ],
)
def test_claims_about_the_time_after_training(says, task, posts, expected):
    pairs = zip(claims.PAPERS, posts, strict=True)
    assert verdict(says, evidence(*(scattered(task, p, post) for p, post in pairs))) == expected


@pytest.mark.parametrize(
    ("clean", "touched", "expected"),
    [(30, 5, "holds"), (5, 30, "does not hold"), (10, 9, "undecided"), (0, 0, "not judged")],
)
def test_spoiled_robots_had_no_contact_before(clean, touched, expected):
    given = evidence(
        robots(WA, "creative", pre=0.0, less=clean), robots(WA, "creative", less=touched, one=9)
    )
    assert verdict("had no contact", given) == expected


@pytest.mark.parametrize(
    ("late", "early", "expected"),
    [(30, 10, "holds"), (2, 60, "does not hold"), (4, 8, "undecided"), (0, 0, "not judged")],
)
def test_robots_take_20_minutes_or_more_to_arrive(late, early, expected):
    curves = np.zeros((late + early + 7, 360))
    curves[:late, 300 + 25 :] = 1.0
    curves[late : late + early, 300 + 3 :] = 0.4
    curves[:, 299] = 1.0  # in training: no arrival in the test
    lives = robots(SF, "creative", one=late + early, un=7)
    given = evidence(lives, curves={f"{SF}/creative": curves})
    assert verdict("20 to 30 minutes", given) == expected


def test_arrival_is_the_first_minute_of_the_test_with_time_in_the_spot():
    curves = np.zeros((3, 360))
    curves[0, [310, 340]] = 0.1
    curves[1, 300] = 1.0
    lives = robots(SF, "creative", one=2, un=1)
    given = evidence(lives, curves={f"{SF}/creative": curves})
    assert claims.arrival_minutes(given, "creative").tolist() == pytest.approx(
        [10, 0, math.nan], nan_ok=True
    )


def stay(first, last, robots=20):
    """Robots that follow the contour, then spin inside, in such shares of their time."""
    wobble = np.linspace(-0.01, 0.01, robots)
    following = np.stack([first[0] + wobble, last[0] - wobble / 2], axis=1)
    spinning = np.stack([first[1] + wobble, last[1] - wobble / 2], axis=1)
    return Stay(np.ones(robots, dtype=bool), following, spinning, np.zeros((0, 3)))


@pytest.mark.parametrize(
    ("stays", "expected"),
    [
        ({"creative": stay((0.8, 0.1), (0.1, 0.8))}, "holds"),
        ({"creative": stay((0.1, 0.8), (0.8, 0.1))}, "does not hold"),
        ({"creative": stay((0.5, 0.5), (0.5, 0.5))}, "undecided"),
        ({"creative": stay((0.8, 0.1), (0.1, 0.8), robots=3)}, "undecided"),
        ({}, "not judged"),
    ],
)
def test_robots_follow_the_contour_then_spin(stays, expected):
    given = evidence(robots(SF, "creative", one=9), behaviour=Behaviour({}, stays))
    assert verdict("follow the spot's contour", given) == expected


@pytest.mark.parametrize(
    ("after", "expected"), [(0.9, "holds"), (0.1, "does not hold"), (None, "not judged")]
)
def test_trained_robots_spin(after, expected):
    spinning = {
        (WA, p): np.tile([0.2, 0.9 if after is None else after], (24, 1)) for p in claims.PAPERS
    }
    if after is None:
        del spinning[WA, "random"]
    given = evidence(robots(WA, "fixed", one=9), behaviour=Behaviour(spinning, {}))
    assert (
        verdict("wall_avoidance: After training most robots of each kind spin", given) == expected
    )


def test_what_only_brains_can_tell_is_not_judged_and_says_where_to_look():
    given = evidence(robots(SF, "creative", one=9))
    left = [f for f in judge_all(given) if "musebot report" in f.why]
    assert len(left) == 3
    assert {f.verdict for f in left} == {"not judged"}


@pytest.mark.parametrize(
    "given",
    [
        evidence(robots(WA, "fixed", one=1)),
        evidence(robots(SF, "creative", bad=4)),
        evidence(*(robots(t, p, un=5) for t in (WA, SF) for p in claims.PAPERS)),
        evidence(*(robots(t, p, one=1) for t in (WA, SF) for p in claims.PAPERS)),
        evidence(*(robots(t, p, one=6) for t in (WA, SF) for p in claims.PAPERS)),
        evidence(robots(SF, "creative", one=6), curves={f"{SF}/creative": np.zeros((6, 1))}),
        evidence(robots(SF, "creative", one=9), time_scale=0.01),
    ],
    ids=["one", "invalid", "unmeasured", "one each", "all equal", "a minute", "rehearsal"],
)
def test_every_claim_about_degenerate_lives_has_a_verdict_and_a_reason(given, recwarn):
    for finding in judge_all(given):
        assert finding.verdict in ("holds", "undecided", "does not hold", "not judged")
        assert finding.why.endswith(".")
        json.dumps(finding.plain(), allow_nan=False)
    text = tables.markdown(given.experiment, given.results)
    assert "nan" not in text
    json.dumps(tables.as_json(given.experiment, given.results), allow_nan=False)
    assert not recwarn.list


def test_the_papers_own_numbers_bear_out_what_they_must():
    # Table 1 and 2 as lives of 500: what the paper claims of categories, its counts show.
    from musebot.protocols.results.learn_ability import PAPER

    kinds = ("one", "some", "zero", "less", "un")
    groups = [
        robots(*condition, **dict(zip(kinds, column.counts, strict=True)))
        for condition, column in PAPER.items()
    ]
    findings = judge_all(evidence(*groups))
    found = {f.claim.says: f.verdict for f in findings}
    for says in ("Fixed has the most geniuses.", "Random has the fewest geniuses."):
        assert found[says] == "holds"
    assert found["Random robots mostly have L < 0."] == "holds"
    assert found["Fixed robots are mostly ignorant."] == "holds"
    # 282 against 260 of 500 is no significant difference: the paper's claim rests on chance.
    assert found["Creative has most robots with L = 1."] == "undecided"
    # Judged from the table or from the lives, counts say the same.
    assert all(f.papers == f.verdict for f in findings if "Fisher" in f.why)


@pytest.mark.parametrize("brain", ["steady", "paper-content"])
def test_of_lives_with_another_brain_no_claim_is_judged(brain):
    given = three(WA, "one", 90, 80, 10)
    assert judge_all(given)
    other = dataclasses.replace(given.experiment, brain=BRAINS[brain])
    assert judge_all(dataclasses.replace(given, experiment=other)) == []
    assert "claims" not in tables.markdown(other, given.results)


def test_beside_each_verdict_stands_the_papers_own():
    found = {f.claim.says: f for f in judge_all(three(WA, "one", 90, 80, 10))}
    ours = found["Creative has most robots with L = 1."]
    assert (ours.verdict, ours.papers) == ("does not hold", "undecided")
    assert ours.words.endswith("The paper's own numbers: undecided.")
    # The paper prints mean contact without its scatter: nothing to judge by.
    contact = found["Random's contact after training is the lowest."]
    assert contact.papers == "not judged"
    assert "paper" not in contact.words


def test_the_papers_means_are_those_of_its_measured_robots():
    ability = claims.PapersOwn(Experiment(), Results([], {}, {})).ability
    assert ability(SF, "fixed") == (0.0800, 0.9681, 500 - 455)
    assert ability(WA, "creative") == (0.6109, 0.7068, 500 - 73)


def test_p_is_two_sided_and_against_a_claim_corrected_for_its_comparisons():
    given = three(WA, "one", 60, 40, 40)
    finding = next(f for f in judge_all(given) if f.claim.says.startswith("Creative has most"))
    against = comparisons.larger_share((40, 100), (60, 100), "").p_true
    assert f"fixed 60 of 100 (p = {2 * 2 * against:.2g} against it)" in finding.why


# ---- The tests themselves, against small oracles ----


def hypergeometric_tail(a, n, b, m):
    """P(at least a of the a + b marked robots fall among the first n), by counting."""
    marked, robots = a + b, n + m
    ways = [
        math.comb(marked, k) * math.comb(robots - marked, n - k) for k in range(min(marked, n) + 1)
    ]
    return sum(ways[a:]) / math.comb(robots, n)


@pytest.mark.parametrize(("a", "n", "b", "m"), [(7, 9, 2, 8), (3, 10, 3, 10), (0, 5, 4, 6)])
def test_fishers_p_values_count_tables(a, n, b, m):
    found = comparisons.larger_share((a, n), (b, m), "")
    assert found.p_false == pytest.approx(hypergeometric_tail(a, n, b, m))
    assert found.p_true == pytest.approx(hypergeometric_tail(b, m, a, n))


def test_a_majoritys_p_value_counts_coins():
    found = comparisons.majority(8, 10, "")
    assert found.p_false == pytest.approx(sum(math.comb(10, k) for k in (8, 9, 10)) / 2**10)
    assert found.p_true == pytest.approx(1 - sum(math.comb(10, k) for k in (9, 10)) / 2**10)


def test_twice_as_many_is_a_coin_that_falls_two_to_one():
    found = comparisons.larger_share((9, 100), (1, 100), "", times=2)
    tail = sum(math.comb(10, k) * (2 / 3) ** k * (1 / 3) ** (10 - k) for k in (9, 10))
    assert found.p_false == pytest.approx(tail)


def sample(values):
    return comparisons.Sample(values.mean(), values.std(ddof=1), len(values))


def test_welchs_t_as_in_the_textbook():
    first, second = (
        np.array([27.5, 21.0, 19.0, 23.6, 17.0]),
        np.array([27.1, 22.0, 20.8, 23.4, 23.4]),
    )
    spread = first.var(ddof=1) / 5 + second.var(ddof=1) / 5
    t = (first.mean() - second.mean()) / math.sqrt(spread)
    freedom = spread**2 / ((first.var(ddof=1) / 5) ** 2 / 4 + (second.var(ddof=1) / 5) ** 2 / 4)
    # The tail of Student's distribution, integrated by hand.
    x = np.linspace(-200, t, 2_000_001)
    density = (1 + x**2 / freedom) ** (-(freedom + 1) / 2)
    density *= math.gamma((freedom + 1) / 2) / math.gamma(freedom / 2)
    density /= math.sqrt(freedom * math.pi)
    found = comparisons.larger_mean(sample(first), sample(second), "")
    assert found.p_true == pytest.approx(np.trapezoid(density, x), abs=1e-5)
    assert found.p_false == pytest.approx(1 - found.p_true)
    shifted = comparisons.larger_mean(sample(first + 0.3), sample(second), "", margin=0.3)
    assert shifted.p_true == pytest.approx(found.p_true)


def test_signed_ranks_count_signs():
    first = np.array([5.0, 4.0, 3.0, 2.0, 1.0, 7.0])
    found = comparisons.larger_in_pairs(first, np.zeros(6), "")
    assert found.p_false == pytest.approx(1 / 2**6)  # all six positive: one way of 64
    assert found.p_true == pytest.approx(1.0)


def test_a_true_claim_is_seldom_refuted_and_a_false_one_seldom_upheld():
    # Where all three kinds are alike, "has the most" is false: upheld at most once in forty.
    random = np.random.default_rng(1)
    claim = Claim(WA, "", claims.ranks(WA, "fixed", "L = 1", most=True))
    found = [
        judge(claim, three(WA, "one", *random.binomial(60, 0.3, 3), of=60)).verdict
        for _ in range(200)
    ]
    assert found.count("holds") <= 10
    assert found.count("does not hold") <= 15
