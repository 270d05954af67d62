"""A run as a value: what is derived from the counts, and what it gives to whoever reads results."""

import dataclasses
from fractions import Fraction

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from musebot.protocols.analysis.comparison import compare_runs
from musebot.protocols.pages import figures, tables
from musebot.protocols.runs.conditions import Condition
from musebot.protocols.runs.experiment import Experiment
from musebot.protocols.runs.run import (
    ConditionResults,
    Lives,
    Robot,
    Run,
    results_of,
)
from musebot.protocols.runs.run_files import export_robots
from musebot.tasks.lives import LIVES

NAN = float("nan")
WALLS, SPOT = Condition("wall_avoidance", "fixed"), Condition("spot_finding", "creative")
AGENT = Condition("wall_avoidance", "a.b:c")
SHORT = Experiment(seed=9, cohort_size=2, time_scale=0.011)  # 1,056 steps: 1.76 minutes


def lives(condition, counts, valid):
    """Returns lives whose robots had the event in so many steps before and after training."""
    counts = np.array(counts)
    minutes = len(SHORT.life_of(condition.life).steps_of_minutes())
    return Lives(
        np.insert(counts, 1, 0, axis=1).astype(np.int32),
        np.repeat(counts[:, :1], minutes, axis=1).astype(np.int16),
        valid,
        {},
        {},
    )


# Derived

pairs = st.lists(st.tuples(st.integers(0, 26), st.integers(0, 26), st.booleans()), min_size=1)


@example(WALLS, [(0, 0, True)])  # a genius
@example(SPOT, [(0, 0, True)])  # ignorant
@given(st.sampled_from([WALLS, SPOT]), pairs)
def test_times_classes_and_curves_follow_from_the_counts(condition, rows):
    counts, valid = [row[:2] for row in rows], np.array([row[2] for row in rows])
    part = ConditionResults.of(SHORT, condition, lives(condition, counts, valid))
    steps = SHORT.life_of(condition.life).steps_of_minutes()
    for number, ((pre, post), robot) in enumerate(zip(counts, part.robots, strict=True)):
        assert (robot.task, robot.proposer) == (condition.life, condition.proposer)
        assert (robot.seed, robot.cohort, robot.robot) == (9, number // 2, number)
        assert (robot.t_pre_s, robot.t_post_s) == (pre / 10, post / 10)
        assert robot.valid == valid[number]
        curve = [float(np.float32(Fraction(pre, int(n)))) for n in steps]
        np.testing.assert_allclose(part.curves[number], curve, rtol=1e-6)
        if not valid[number]:
            assert robot.category == "invalid" and np.isnan(robot.learn_ability)
        elif pre == post == 0:
            assert robot.category == ("genius" if condition == WALLS else "ignorant")
            assert np.isnan(robot.learn_ability)
        else:
            gain = pre - post if condition == WALLS else post - pre
            wanted = Fraction(gain, pre + post)
            assert robot.learn_ability == pytest.approx(float(wanted), abs=1e-15)
            named = {1: "L = 1", 0: "L = 0"}.get(wanted, "0 < L < 1" if wanted > 0 else "L < 0")
            assert robot.category == named


def test_a_life_without_tests_has_a_score_and_no_class(tmp_path):
    body, valid = Condition("body", "fixed"), np.array([True, False, True])
    measured = {body: lives(body, [(0, 0), (3, 0), (5, 9)], valid)}
    run = Run("x", SHORT, results_of(SHORT, measured))
    assert [row.category for row in run.robots(body)] == ["", "invalid", ""]
    assert run.life_shares(body).shape == (2,)
    export_robots(tmp_path, SHORT, measured)
    rows = (tmp_path / "robots.csv").read_text().splitlines()[1:]
    assert [row.split(",", 5)[5] for row in rows] == [",,,", ",,,invalid", ",,,"]
    for figure in (figures.categories, figures.abilities):
        assert figure(run) is None
    (cell, *others) = compare_runs(run, run)
    assert not others and cell.name == "share of time in the spot" and cell.difference == 0
    text = tables.markdown(run)
    assert (
        "ignorant" not in text and "classed" not in text and "| share of time in the spot |" in text
    )


def test_a_test_after_training_alone_has_times_and_no_class():
    phases = LIVES["spot_finding"].phases[1:]
    life = dataclasses.replace(LIVES["spot_finding"], name="late", phases=phases)
    experiment, late = dataclasses.replace(SHORT, life=life), Condition("late", "fixed")
    steps = experiment.life_of("late").steps_of_minutes()
    found = Lives(np.array([[0, 9, 6]]), steps[None] * 0, np.array([True]), {}, {})
    run = Run("x", experiment, results_of(experiment, {late: found}))
    seconds = run.test_seconds("late")
    assert run.shares(late, "post").tolist() == [pytest.approx(0.6 / seconds)]
    assert np.isnan([*run.shares(late, "pre"), *run.abilities(late)]).all()
    assert run.robots(late)[0].category == ""


# A run

ROWS = [
    Robot("wall_avoidance", "fixed", 1, 0, 0, 30.0, 10.0, 0.5, "0 < L < 1"),
    Robot("wall_avoidance", "fixed", 1, 0, 1, 9.0, 900.0, NAN, "invalid"),
    Robot("wall_avoidance", "fixed", 1, 1, 2, 30.0, 0.0, 1.0, "L = 1"),
    Robot("wall_avoidance", "fixed", 1, 1, 3, 0.0, 0.0, NAN, "genius"),
]


def results(rows):
    marks = np.arange(len(rows), dtype=np.float32)[:, None]
    networks = {"before": {"a.weights": marks}, "after": {"a.weights": marks + 0.5}}
    return ConditionResults(rows, marks.repeat(2, axis=1), networks)


@pytest.fixture
def run():
    spot = Robot("spot_finding", "creative", 1, 0, 0, 0.0, 36.0, 1.0, "L = 1")
    agent = Robot("wall_avoidance", "a.b:c", 1, 0, 0, 1.0, 1.0, 0.0, "L = 0")
    without_weights = ConditionResults([agent], np.zeros((1, 2)), {"before": {}, "after": {}})
    found = {WALLS: results(ROWS), AGENT: without_weights, SPOT: results([spot])}
    return Run("mine", Experiment(cohort_size=2), found)


def test_a_run_lists_its_conditions_tasks_and_proposers_in_the_order_of_the_tables(run):
    assert run.conditions() == [WALLS, AGENT, SPOT]
    assert run.tasks() == ["wall_avoidance", "spot_finding"]
    assert run.proposers("wall_avoidance") == ["fixed", "a.b:c"]
    assert run.proposers("spot_finding") == ["creative"]


def test_invalid_robots_count_nowhere_but_among_the_rows(run):
    assert run.robots(WALLS) == ROWS
    assert [row.robot for row in run.valid(WALLS)] == [0, 2, 3]
    assert run.valid_rows(WALLS) == [0, 2, 3]
    assert run.curves(WALLS).tolist() == [[0, 0], [2, 2], [3, 3]]
    np.testing.assert_array_equal(run.abilities(WALLS), [0.5, 1, NAN])
    assert run.shares(WALLS, "post").tolist() == pytest.approx([10 / 1200, 0, 0])
    assert run.shares(WALLS, "pre").tolist() == pytest.approx([30 / 1200, 30 / 1200, 0])
    summary = run.summary(WALLS)
    assert (summary.counts, summary.invalid) == ((1, 1, 0, 0, 1), 1)
    assert summary.mean == pytest.approx(0.75)
    assert summary.post_share == pytest.approx(10.0 / 3 / 1200)


def test_networks_are_those_of_all_robots_and_a_condition_without_robots_is_empty(run):
    assert run.networks(WALLS, "before")["a.weights"][:, 0].tolist() == [0, 1, 2, 3]
    assert run.networks(WALLS, "after")["a.weights"][:, 0].tolist() == [0.5, 1.5, 2.5, 3.5]
    missing = Condition("spot_finding", "fixed")
    assert run.networks(AGENT, "after") == run.networks(missing, "after") == {}
    assert run.robots(missing) == run.valid(missing) == []
    assert run.summary(missing).robots == 0
    assert run.abilities(missing).shape == run.shares(missing, "post").shape == (0,)


def test_the_test_after_training_lasts_20_minutes_or_an_hour(run):
    assert run.test_seconds("wall_avoidance") == pytest.approx(20 * 60)
    half = Run("half", Experiment(time_scale=0.5), {})
    assert half.test_seconds("spot_finding") == pytest.approx(30 * 60)
