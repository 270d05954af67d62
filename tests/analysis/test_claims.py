"""Claims: verdicts on robots made by hand, where everybody sees what they must be."""

import dataclasses
import json
import math

import numpy as np
import pytest

from musebot.controller import BRAINS, PROPOSERS
from musebot.protocols.analysis import claim_tests, claims, hypothesis_tests, paper_claims
from musebot.protocols.analysis.behaviour import Behaviour, Stay
from musebot.protocols.analysis.claims import Claim, Evidence, judge
from musebot.protocols.analysis.paper_claims import CLAIMS, judge_all
from musebot.protocols.analysis.paper_tables import PAPER
from musebot.protocols.lives.conditions import Condition
from musebot.protocols.lives.experiment import Experiment
from musebot.protocols.lives.run import ConditionResults, Robot, Run
from musebot.protocols.lives.schedules import SCHEDULES
from musebot.protocols.pages import tables

WA, SF = "wall_avoidance", "spot_finding"
NAMES = {"one": "L = 1", "some": "0 < L < 1", "zero": "L = 0", "less": "L < 0"}
ABILITY = {"one": 1.0, "some": 0.5, "zero": 0.0, "less": -0.5, "un": float("nan")}


def robots(task, proposer, pre=1.0, post=1.0, **counts):
    """Returns rows of a condition, with so many robots of each category."""
    kinds = [kind for kind, count in counts.items() for _ in range(count)]
    names = NAMES | {"un": SCHEDULES[task].unmeasured, "bad": "invalid"}
    return [
        Robot(task, proposer, 1, 0, i, pre, post, ABILITY.get(kind, math.nan), names[kind])
        for i, kind in enumerate(kinds)
    ]


def run_of(*groups, curves=None, time_scale=1.0):
    """Returns a run of some rows; curves by condition, no event without them."""
    rows = {}
    for row in (row for group in groups for row in group):
        rows.setdefault(Condition(row.task, row.proposer), []).append(row)
    minutes = {WA: 160, SF: 360}
    results = {
        c: ConditionResults(
            own,
            (curves or {}).get(c, np.zeros((len(own), minutes[c.task]))),
            {"before": {}, "after": {}},
        )
        for c, own in rows.items()
    }
    return Run("run", Experiment(time_scale=time_scale), results)


def evidence(*groups, behaviour=None, **options):
    return Evidence(run_of(*groups, **options), behaviour)


def verdict(says, given):
    found = [claim for claim in CLAIMS if says in f"{claim.task}: {claim.says}"]
    assert len(found) == 1, [c.says for c in found]
    return judge(found[0], given).verdict


def three(task, category, fixed, random, creative, of=100):
    other = "some" if category != "some" else "one"
    return evidence(
        *(
            robots(task, proposer, **{category: n, other: of - n})
            for proposer, n in zip(PROPOSERS, (fixed, random, creative), strict=True)
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


def test_an_untestable_inequality_does_not_save_a_claim_that_another_refutes():
    few, rest = robots(WA, "fixed", one=3, un=97), {"one": 60, "less": 40}
    spots = [robots(SF, proposer, **rest) for proposer in PROPOSERS]
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
    given = [robots(t, p, **k) for t, k in ((WA, walls), (SF, spots)) for p in PROPOSERS]
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
def test_means_are_alike_only_if_both_differences_are_excluded(fixed, creative, expected):
    given = evidence(robots(SF, "fixed", **fixed), robots(SF, "creative", **creative))
    assert verdict("about Fixed's", given) == expected


def scattered(task, proposer, post, count=60):
    """Returns robots whose time after training is half of `post` seconds or one and a half."""
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
    pairs = zip(PROPOSERS, posts, strict=True)
    assert verdict(says, evidence(*(scattered(task, p, post) for p, post in pairs))) == expected


@pytest.mark.parametrize(
    ("clean", "touched", "expected"),
    [(30, 5, "holds"), (5, 30, "does not hold"), (10, 9, "undecided"), (0, 0, "not judged")],
)
def test_spoiled_robots_had_no_contact_before_training(clean, touched, expected):
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
    rows = robots(SF, "creative", one=late + early, un=7)
    given = evidence(rows, curves={Condition(SF, "creative"): curves})
    assert verdict("20 to 30 minutes", given) == expected


def test_arrival_is_the_first_minute_of_the_test_with_time_in_the_spot():
    curves = np.zeros((3, 360))
    curves[0, [310, 340]] = 0.1
    curves[1, 300] = 1.0
    rows = robots(SF, "creative", one=2, un=1)
    given = evidence(rows, curves={Condition(SF, "creative"): curves})
    found = claims.arrival_minutes(given, Condition(SF, "creative")).tolist()
    assert found == pytest.approx([10, 0, math.nan], nan_ok=True)


@pytest.mark.parametrize(
    ("held", "expected"),
    [((30, 2, 3), "holds"), ((2, 30, 3), "does not hold"), ((5, 4, 2), "undecided")],
)
def test_fixed_robots_alone_stay_at_a_wall(held, expected):
    columns = [
        [
            *robots(WA, proposer, post=1140.0, less=count),
            *robots(WA, proposer, post=1139.0, less=100 - count),
        ]
        for proposer, count in zip(PROPOSERS, held, strict=True)
    ]
    assert verdict("do not leave the wall", evidence(*columns)) == expected


@pytest.mark.parametrize(
    ("random", "creative", "expected"),
    [
        ({"one": 40, "un": 5, "some": 55}, {"one": 70, "un": 25, "some": 5}, "holds"),
        ({"one": 40, "un": 25, "some": 35}, {"one": 70, "un": 5, "some": 25}, "does not hold"),
        ({"one": 40, "un": 5, "some": 55}, {"one": 70, "un": 7, "some": 23}, "undecided"),
    ],
)
def test_creative_has_more_geniuses_and_perfect_learners_than_random(random, creative, expected):
    given = evidence(robots(WA, "random", **random), robots(WA, "creative", **creative))
    assert verdict("more geniuses than random", given) == expected


@pytest.mark.parametrize(
    ("stayed", "expected"), [(20, "holds"), (0, "does not hold"), (6, "undecided")]
)
def test_quite_a_few_newborns_stay_in_the_spot(stayed, expected):
    rows = robots(SF, "creative", pre=1800.0, some=stayed)
    rows += robots(SF, "creative", pre=1799.0, some=100 - stayed)
    assert verdict("quite a few creative robots", evidence(rows)) == expected


@pytest.mark.parametrize(
    ("learnt", "expected"), [(30, "holds"), (1, "does not hold"), (15, "undecided")]
)
def test_newborns_that_stay_are_easily_trained(learnt, expected):
    curves = np.zeros((60, 360))
    curves[:learnt, 240:300] = 0.5
    curves[learnt:, 60:240] = 1.0  # before the last quarter
    rows = robots(SF, "creative", pre=1800.0, one=30) + robots(SF, "creative", pre=0.0, one=30)
    given = evidence(rows, curves={Condition(SF, "creative"): curves})
    assert verdict("easily trained", given) == expected
    nobody = evidence(robots(SF, "creative", pre=0.0, one=30))
    assert verdict("easily trained", nobody) == "not judged"


@pytest.mark.parametrize(
    ("before", "after", "expected"),
    [(2, 25, "holds"), (25, 2, "does not hold"), (2, 2, "undecided"), (2, None, "not judged")],
)
def test_robots_with_negative_l_arrive_later(before, after, expected):
    curves = np.zeros((40, 360))
    curves[:, before:60] = 1.0
    if after is not None:
        curves[:20, 300 + after :] = 1.0
    rows = robots(SF, "creative", less=20, some=20)
    given = evidence(rows, curves={Condition(SF, "creative"): curves})
    assert verdict("arrive later after training", given) == expected


def stay(first, last, robots=20):
    """Returns robots with these shares of following and spinning, at first and at last."""
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
    ("after", "expected"),
    [(0.6, "holds"), (0.4, "does not hold"), (0.1, "does not hold"), (None, "not judged")],
)
def test_trained_robots_spin(after, expected):
    shares = np.tile([0.2, 0.9 if after is None else after], (24, 1))
    spinning = {Condition(WA, proposer): shares for proposer in PROPOSERS}
    if after is None:
        del spinning[Condition(WA, "random")]
    given = evidence(robots(WA, "fixed", one=9), behaviour=Behaviour(spinning, {}))
    assert (
        verdict("wall_avoidance: After training most robots of each kind spin", given) == expected
    )


@pytest.mark.parametrize(("way", "expected"), [(0.05, "holds"), (-0.05, "does not hold")])
def test_spinners_that_come_nearer_to_the_centre_are_counted(way, expected):
    """Twelve robots of each kind spin and move; twelve others do the opposite."""
    shares = np.repeat([[0.2, 0.9], [0.9, 0.1]], 12, axis=0)
    ways = np.repeat([[0.0, way], [0.0, -way]], 12, axis=0)
    conditions = [Condition(WA, proposer) for proposer in PROPOSERS]
    behaviour = Behaviour(
        dict.fromkeys(conditions, shares), {}, nearer=dict.fromkeys(conditions, ways)
    )
    given = evidence(robots(WA, "fixed", one=24), behaviour=behaviour)
    assert verdict("most trained spinners come nearer", given) == expected


@pytest.mark.parametrize(("pre", "expected"), [(0.0, "holds"), (1.0, "does not hold")])
def test_newborn_spinners_without_contact_are_counted(pre, expected):
    """The first robots spin from birth; the others are not asked for."""
    shares = np.repeat([[0.9, 0.0], [0.1, 0.9]], 10, axis=0)
    rows = [*robots(WA, "fixed", pre=pre, one=10), *robots(WA, "fixed", pre=1 - pre, one=10)]
    behaviour = Behaviour({Condition(WA, "fixed"): shares}, {})
    assert verdict("spins from birth", evidence(rows, behaviour=behaviour)) == expected
    behaviour = Behaviour({Condition(WA, "fixed"): shares * 0}, {})
    assert verdict("spins from birth", evidence(rows, behaviour=behaviour)) == "not judged"


@pytest.mark.parametrize(("after", "expected"), [(0.6, "holds"), (0.1, "does not hold")])
def test_more_spinning_after_training_is_tested_robot_by_robot(after, expected):
    before = np.linspace(0.2, 0.4, 20)
    shares = np.stack([before, before + after - 0.3], axis=1)
    behaviour = Behaviour({Condition(SF, "fixed"): shares}, {})
    given = evidence(robots(SF, "fixed", one=20), behaviour=behaviour)
    assert verdict("Spinning is reinforced", given) == expected


@pytest.mark.parametrize(
    ("fixed", "expected"), [(0.9, "holds"), (0.6, "undecided"), (0.3, "does not hold")]
)
def test_fixed_robots_spin_the_most_if_both_others_spin_less_after_training(fixed, expected):
    wobble = np.linspace(-0.2, 0.2, 20)
    after = {"fixed": fixed, "random": 0.2, "creative": 0.6}
    spinning = {
        Condition(SF, proposer): np.stack([1 - wobble, after[proposer] + wobble / 2], axis=1)
        for proposer in PROPOSERS
    }
    given = evidence(robots(SF, "fixed", one=20), behaviour=Behaviour(spinning, {}))
    assert verdict("fixed robots spin the most", given) == expected
    del spinning[Condition(SF, "random")]
    assert verdict("fixed robots spin the most", given) == "not judged"


def test_claims_about_behaviour_are_not_judged_without_observation():
    given = run_of(robots(SF, "creative", one=9))
    left = [f for f in judge_all(given) if "musebot report" in f.why]
    assert len(left) == 7
    assert {f.verdict for f in left} == {"not judged"}


@pytest.mark.parametrize(
    "given",
    [
        run_of(robots(WA, "fixed", one=1)),
        run_of(robots(SF, "creative", bad=4)),
        run_of(*(robots(t, p, un=5) for t in (WA, SF) for p in PROPOSERS)),
        run_of(*(robots(t, p, one=1) for t in (WA, SF) for p in PROPOSERS)),
        run_of(*(robots(t, p, one=6) for t in (WA, SF) for p in PROPOSERS)),
        run_of(robots(SF, "creative", one=6), curves={Condition(SF, "creative"): np.zeros((6, 1))}),
        run_of(robots(SF, "creative", one=9), time_scale=0.01),
    ],
    ids=["one", "invalid", "unmeasured", "one each", "all equal", "a minute", "shortened"],
)
def test_every_claim_about_degenerate_runs_has_a_verdict_and_a_reason(given, recwarn):
    for result in judge_all(given):
        assert result.verdict in ("holds", "undecided", "does not hold", "not judged")
        assert result.why.endswith(".")
        json.dumps(result.as_json(), allow_nan=False)
    text = tables.markdown(given)
    assert "nan" not in text
    json.dumps(tables.as_json(given), allow_nan=False)
    assert not recwarn.list


def test_a_run_with_the_papers_counts_supports_its_claims_about_categories():
    kinds = ("one", "some", "zero", "less", "un")
    groups = [
        robots(condition.task, condition.proposer, **dict(zip(kinds, column.counts, strict=True)))
        for condition, column in PAPER.items()
    ]
    results = judge_all(run_of(*groups))
    found = {f.claim.says: f.verdict for f in results}
    for says in ("Fixed has the most geniuses.", "Random has the fewest geniuses."):
        assert found[says] == "holds"
    assert found["Random robots mostly have L < 0."] == "holds"
    assert found["Fixed robots are mostly ignorant."] == "holds"
    # 282 against 260 of 500 is no significant difference: the paper's claim rests on chance.
    assert found["Creative has most robots with L = 1."] == "undecided"
    # The table and the single robots give the same verdict.
    tested = [f for f in results if "Fisher" in f.why and f.paper != "not judged"]
    assert tested
    assert all(f.paper == f.verdict for f in tested)


@pytest.mark.parametrize("brain", ["steady", "paper-stopping"])
def test_no_claim_is_judged_for_another_brain(brain):
    run = three(WA, "one", 90, 80, 10).run
    assert judge_all(run)
    other = dataclasses.replace(run, experiment=Experiment(brain=BRAINS[brain]))
    assert judge_all(other) == []
    assert "claims" not in tables.markdown(other)


def test_each_result_has_the_verdict_by_the_papers_tables():
    found = {f.claim.says: f for f in judge_all(three(WA, "one", 90, 80, 10).run)}
    ours = found["Creative has most robots with L = 1."]
    assert (ours.verdict, ours.paper) == ("does not hold", "undecided")
    assert ours.words.endswith("The paper's own numbers: undecided.")
    # The paper prints the mean contact without its scatter.
    contact = found["Random's contact after training is the lowest."]
    assert contact.paper == "not judged"
    assert "paper" not in contact.words


def test_the_papers_means_are_those_of_its_measured_robots():
    def ability(task, proposer):
        return paper_claims.ability(Evidence(None), Condition(task, proposer))

    assert ability(SF, "fixed") == (0.0800, 0.9681, 500 - 455)
    assert ability(WA, "creative") == (0.6109, 0.7068, 500 - 73)


def test_p_is_two_sided_and_corrected_for_the_number_of_inequalities_if_against_a_claim():
    run = three(WA, "one", 60, 40, 40).run
    result = next(f for f in judge_all(run) if f.claim.says.startswith("Creative has most"))
    against = hypothesis_tests.larger_share((40, 100), (60, 100), "").p_against
    assert f"fixed 60 of 100 (p = {2 * 2 * against:.2g} against it)" in result.why


def test_no_p_exceeds_one_and_a_number_without_a_test_is_shown_without_p():
    tested = hypothesis_tests.TestedInequality("60 of 100 and 40 of 100", "Fisher", 0.2, 0.9)
    shown = hypothesis_tests.TestedInequality("0 of 0", "Fisher", math.nan, math.nan)
    given = three(WA, "one", 60, 40, 40)
    result = judge(Claim(WA, "", lambda _: [tested, shown]), given)
    assert result.why == "60 of 100 and 40 of 100 (p = 0.4); 0 of 0. Fisher."
    unlikely = dataclasses.replace(tested, p_for=0.9, p_against=0.7)
    result = judge(Claim(WA, "", lambda _: [unlikely]), given)
    assert result.why == "60 of 100 and 40 of 100 (p = 1 against it). Fisher."
    unlikely = dataclasses.replace(tested, p_for=0.6, p_against=0.7)
    result = judge(Claim(WA, "", lambda _: [unlikely]), given)
    assert result.why == "60 of 100 and 40 of 100 (p = 1). Fisher."


def test_a_true_claim_rarely_fails_and_a_false_one_rarely_holds():
    # If all three kinds are equal, "has the most" is false: it holds in at most one of forty.
    random = np.random.default_rng(1)
    claim = Claim(WA, "", claim_tests.ranks(Condition(WA, "fixed"), "L = 1", most=True))
    found = [
        judge(claim, three(WA, "one", *random.binomial(60, 0.3, 3), of=60)).verdict
        for _ in range(200)
    ]
    assert found.count("holds") <= 10
    assert found.count("does not hold") <= 15
    found = [
        judge(claim, three(WA, "one", *random.binomial(60, [0.6, 0.3, 0.3]), of=60)).verdict
        for _ in range(200)
    ]
    assert found.count("holds") >= 120  # both of its inequalities: power about 0.85 to 0.9 each
    assert found.count("does not hold") == 0
