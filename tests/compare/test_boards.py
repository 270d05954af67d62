"""Learners are ranked between a newborn and a hand-coded robot."""

import dataclasses
from unittest.mock import Mock

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from musebot.controller import BRAINS
from musebot.protocols.agents.names import recorded_name
from musebot.protocols.compare.boards import Board, Entry, boards, pair_tests, ranked
from musebot.protocols.compare.leaderboard_page import page
from musebot.protocols.errors import InputError
from musebot.protocols.lives.conditions import Condition
from musebot.protocols.lives.experiment import Experiment
from musebot.protocols.lives.run import Robot, Run, results_of

SPOT, WALLS = "spot_finding", "wall_avoidance"
STEADY = BRAINS["steady"]
SATURATED = dataclasses.replace(STEADY, raw_signals=False, raw_reward=False)
BOARD, CONTACT = Board("raw", SPOT), Board("raw", WALLS)


@pytest.fixture(autouse=True)
def few_draws(monkeypatch):
    """Fewer draws than for a page, which take less time."""
    monkeypatch.setattr("musebot.protocols.compare.boards.DRAWS", 5000)


def entry(name, after, training, robots=20, spread=0.0, task=SPOT, **fields):
    wobble = spread * np.linspace(-1, 1, robots)
    after, training = after + wobble, training + wobble
    curve = np.linspace(0, 2 * np.mean(training), 120)
    return Entry(
        Experiment(**fields), Condition(task, name), after, training, curve,
        np.full(robots, np.nan),
    )  # fmt: skip


NEWBORN, CODED = recorded_name("newborn"), recorded_name("hand_coded")
LOW, HIGH = entry(NEWBORN, 0.1, 0.1, spread=0.02), entry(CODED, 0.9, 0.9)
ENTRIES = [
    LOW,
    entry("mine:slow", 0.5, 0.2, spread=0.05),
    entry("mine:good", 0.8, 0.7, spread=0.05),
    HIGH,
    entry("mine:alike", 0.79, 0.7, spread=0.05),
]


def names(ranking):
    return [one.entry.name for one in ranking]


def rows_of(found, costs=None, tunings=None):
    """Returns the rows of a page's tables, by the head of their first column and its title."""
    text = page(found, costs or {}, tunings or {}).markdown
    lines = [line for line in text.splitlines() if line.startswith("| ")]
    return [[cell.strip() for cell in line.split("|")[1:-1]] for line in lines]


def test_a_score_is_0_for_the_mean_newborn_and_1_for_the_mean_hand_coded_robot():
    found = {one.entry.name: one.scores for one in ranked([LOW, HIGH, entry("mine:a", 0.5, 0.9)])}
    assert found["newborn"].mean() == pytest.approx(0)
    assert found["hand_coded"] == pytest.approx(1)
    assert found["mine:a"] == pytest.approx((0.5 + 1) / 2)


@settings(suppress_health_check=[HealthCheck.function_scoped_fixture], max_examples=30)
@given(st.lists(st.floats(-1, 2), min_size=1, max_size=60))
def test_a_score_is_the_mean_of_the_middle_half_of_the_robots(values):
    values = np.array(values)
    learner = dataclasses.replace(entry("mine:a", 0.0, 0.0), after=values, training=values)
    bounds = entry(NEWBORN, 0.0, 0.0), entry(CODED, 1.0, 1.0)
    (one,) = [one for one in ranked([learner, *bounds]) if one.entry is learner]
    low, high = one.interval
    cut = len(values) // 4
    assert one.score == pytest.approx(np.sort(values)[cut : len(values) - cut].mean())
    assert values.min() - 1e-9 <= low <= high <= values.max() + 1e-9


def test_the_interval_of_a_score_has_the_chance_in_the_bounds_too():
    learner = entry("mine:a", 0.5, 0.5)  # equal robots: all of the chance is in the bounds
    wide, narrow = (
        ranked([learner, entry(NEWBORN, 0.1, 0.1, spread=spread), HIGH])[1].interval
        for spread in (0.2, 0.0)
    )
    assert narrow == pytest.approx((0.5, 0.5))
    # Standard error of the mean of 20 newborns, spread evenly over 0.4; 0.8 is the scores' unit.
    error = 0.4 / np.sqrt(12) * np.sqrt(21 / 19) / np.sqrt(20)
    assert wide[1] - wide[0] == pytest.approx(2 * 1.96 * error * 0.5 / 0.8, rel=0.15)


def test_learners_are_ranked_and_tested_in_pairs():
    ranking = ranked(ENTRIES)
    assert names(ranking) == ["hand_coded", "mine:good", "mine:alike", "mine:slow", "newborn"]
    tests = pair_tests(ranking)
    np.testing.assert_equal(tests, tests.T)
    bound, own, alike, slow, other = tests[1]
    assert np.isnan([bound, own, other]).all() and alike > 0.05 > slow
    # A learner more changes no interval; what was trained beforehand is not compared.
    more = ranked([entry("mine:new", 0.4, 0.4), entry(recorded_name("ppo"), 0.95, 1), *ENTRIES])
    assert {(one.entry.name, one.interval) for one in ranking} <= {
        (one.entry.name, one.interval) for one in more
    }
    assert names(more)[0] == "ppo" and np.isnan(pair_tests(more)[0]).all()


def test_the_page_has_a_row_a_learner_and_marks_those_that_may_be_the_first():
    touching = entry("mine:good", 1.0, 1.0, task=WALLS)
    touching = dataclasses.replace(touching, after=np.repeat([1.0, 0.9], [18, 2]))
    walls = [dataclasses.replace(e, condition=Condition(WALLS, e.condition.proposer))
             for e in (LOW, HIGH)]  # fmt: skip
    others = [entry("mine:alike", 0.9, 0.8, spread=0.05), entry("mine:slow", 0.2, 0.2)]
    found = {
        CONTACT: [touching, *walls],
        BOARD: ENTRIES,
        Board("raw", "spot_finding_walls"): [LOW, HIGH, *others],
    }
    rows = rows_of(found, {(BOARD, "mine:slow"): np.array([8.0, 4.0, 2048.0])})
    assert rows[0] == ["learner", "spot finding", "spot finding, walls sensed", "touch a wall"]
    summary = {row[0]: row[1:] for row in rows[2:7]}
    assert [*summary] == ["*hand_coded*", "mine:good", "mine:alike", "mine:slow", "*newborn*"]
    bold = {name: [cell[:2] == "**" for cell in cells[:2]] for name, cells in summary.items()}
    assert bold["mine:good"] == [True, False] and summary["mine:good"][1:] == ["-", "2 of 20"]
    assert bold["mine:alike"] == [True, True] and bold["mine:slow"] == [False, False]
    assert summary["*hand_coded*"][0].startswith("1.000 [")
    (slow,) = [row for row in rows if row[0] == "mine:slow" and "8.0" in row]
    assert slow[1:] == ["8.0", "2.0", "2.0", "defaults", "`--agent mine:slow`"]
    contact = [row for row in rows if row[0] == "mine:good"][1]
    assert contact[2].startswith("2 ")


def test_few_robots_are_not_tested_and_equal_bounds_give_no_scores():
    few = [dataclasses.replace(e, after=e.after[:4], training=e.training[:4]) for e in ENTRIES]
    assert [row[0] for row in rows_of({BOARD: few})[:7] if row[1].startswith("**")] == ["mine:good"]
    alike = [LOW, ENTRIES[1], dataclasses.replace(HIGH, after=LOW.after, training=LOW.training)]
    assert {row[1] for row in rows_of({BOARD: alike})[2:5]} == {"-"}


def test_the_page_says_how_a_learner_was_tuned():
    tuning = Mock(study=Mock(effort="3 settings"), tried=frozenset({(), ("a=1", "b=2")}))

    def tuned(one, tunings):
        rows = rows_of({BOARD: [one, LOW, HIGH]}, {}, tunings)
        return next(row[4] for row in rows if row[0] == one.name and row[1] == "-")

    for chosen, with_it, without in (
        ((), "3 settings", "defaults"),
        (("b=2", "a=1"), "3 settings", "own settings"),
        (("a=3",), "own settings, not the tuning's", "own settings"),
    ):
        slow = entry("mine:slow", 0.5, 0.2, settings=chosen)
        assert tuned(slow, {("mine:slow", "paper"): tuning}) == with_it
        assert tuned(slow, {}) == without
    for brain, words in (
        (BRAINS["paper"], "as published"),
        (STEADY, "by hand, hundreds of settings"),
        (SATURATED, "by hand, hundreds of settings"),
        (dataclasses.replace(STEADY, noise=0.1), "another brain, see the command"),
    ):
        assert tuned(entry("creative", 0.5, 0.5, brain=brain), {}) == words
    one = entry("creative", 0.5, 0.5, brain=SATURATED)
    assert one.name == "steady, creative" and "brain.raw_reward=false" in one.command


@pytest.fixture
def runs(invented):
    """Invented runs: both bounds, a learner of raw signals, a brain in either track."""

    def run(name, *proposers, **fields):
        experiment, results = Experiment(cohort_size=2, **fields), {}
        for condition in (Condition(t, p) for t in (WALLS, SPOT) for p in proposers):
            row = Robot(condition.task, condition.proposer, 1, 0, 0, 60.0, 90.0, 0.2, "0 < L < 1")
            rows = [row, dataclasses.replace(row, robot=1)]
            results[condition] = invented(experiment, rows)
        return Run(name, experiment, results_of(experiment, results))

    return [
        run("bounds", NEWBORN, CODED),
        run("learner", "mine:a", signals="raw", settings=("rate=0.2",)),
        run("steady", "creative", brain=STEADY),
        run("saturated", "creative", brain=SATURATED),
    ]


def test_runs_become_boards_between_their_bounds(runs):
    found = boards(runs)
    learners = {"paper": ["steady, creative"], "raw": ["mine:a", "steady, creative"]}
    assert found.keys() == {Board(t, task) for t in learners for task in (SPOT, WALLS)}
    for board, entries in found.items():
        assert {e.name for e in entries[:2]} == {"hand_coded", "newborn"}
        assert [e.name for e in entries[2:]] == learners[board.signals]
        share = 90 / runs[0].test_seconds(board.task)
        assert entries[0].after == pytest.approx(share if board.task == SPOT else 1 - share)
    (learner,) = [e for e in found[BOARD] if e.name == "mine:a"]
    assert learner.command == "--agent mine:a --set signals=raw agent.rate=0.2"
    assert learner.world == "cohort_size=2"


def test_a_robot_that_was_stopped_counts_as_the_worst(runs):
    for part in runs[1].results.values():
        part.robots[1] = dataclasses.replace(part.robots[1], category="invalid")
    for entries in boards(runs[:2]).values():
        (one,) = [e for e in entries if e.name == "mine:a"]
        assert one.stopped == 1 and (one.after[1], one.training[1]) == (0, 0)
        assert one.after[0] > 0


def test_runs_that_make_no_board_are_refused(runs):
    with pytest.raises(InputError, match="the runs hold no learner, only bounds"):
        boards(runs[:1])
    with pytest.raises(InputError, match="hold no robots of newborn, a bound"):
        boards(runs[1:])
    with pytest.raises(InputError, match="mine:a stands in two runs of"):
        boards([*runs, dataclasses.replace(runs[1], name="again")])
    moved = dataclasses.replace(runs[1].experiment, nose_place="centre")
    with pytest.raises(InputError, match="differ in nose_place: front and centre"):
        boards([runs[0], dataclasses.replace(runs[1], experiment=moved)])
