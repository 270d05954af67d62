"""A run as a value: what it gives to whoever reads results."""

import sys
from types import SimpleNamespace

import numpy as np
import pytest

from musebot.protocols.errors import InputError
from musebot.protocols.lives.conditions import Condition
from musebot.protocols.lives.experiment import Experiment
from musebot.protocols.lives.run import ConditionResults, Robot, Run, abilities, shares

NAN = float("nan")
WALLS, SPOT = Condition("wall_avoidance", "fixed"), Condition("spot_finding", "creative")
AGENT = Condition("wall_avoidance", "a.b:c")

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


def test_networks_are_those_of_all_robots(run):
    assert run.networks(WALLS, "before")["a.weights"][:, 0].tolist() == [0, 1, 2, 3]
    assert run.networks(WALLS, "after")["a.weights"][:, 0].tolist() == [0.5, 1.5, 2.5, 3.5]
    assert run.networks(AGENT, "after") == {}


def test_a_condition_without_robots_is_empty(run):
    missing = Condition("spot_finding", "fixed")
    assert run.robots(missing) == run.valid(missing) == []
    assert run.networks(missing, "after") == {}
    assert run.summary(missing).robots == 0


def test_a_summary_counts_invalid_robots_and_leaves_them_out(run):
    summary = run.summary(WALLS)
    assert summary.counts == (1, 1, 0, 0, 1)
    assert summary.invalid == 1
    assert summary.mean == pytest.approx(0.75)
    assert summary.post_share == pytest.approx(10.0 / 3 / 1200)


def test_the_test_after_training_lasts_20_minutes_or_an_hour(run):
    assert run.test_seconds("wall_avoidance") == pytest.approx(20 * 60)
    assert run.test_seconds("spot_finding") == pytest.approx(60 * 60)
    half = Run("half", Experiment(time_scale=0.5), {})
    assert half.test_seconds("spot_finding") == pytest.approx(30 * 60)


def test_abilities_and_shares_of_rows():
    np.testing.assert_array_equal(abilities(ROWS), [0.5, NAN, 1, NAN])
    assert shares(ROWS, 100.0, "pre").tolist() == pytest.approx([0.3, 0.09, 0.3, 0])
    assert abilities([]).shape == shares([], 100.0, "post").shape == (0,)


def test_a_frame_has_a_row_for_each_robot_with_the_shares_of_the_tests(run, monkeypatch):
    frames = []
    monkeypatch.setitem(sys.modules, "pandas", SimpleNamespace(DataFrame=frames.append))
    run.to_frame()
    (rows,) = frames
    assert [row["robot"] for row in rows] == [
        robot.robot for condition in run.conditions() for robot in run.robots(condition)
    ]
    for condition in run.conditions():
        own = [
            r for r in rows if (r["task"], r["proposer"]) == (condition.task, condition.proposer)
        ]
        own = [row for row in own if row["category"] != "invalid"]
        for part in ("pre", "post"):
            shares = [row[f"{part}_share"] for row in own]
            assert shares == run.shares(condition, part).tolist()


def test_without_pandas_one_sentence_says_what_helps(run, monkeypatch):
    monkeypatch.setitem(sys.modules, "pandas", None)
    with pytest.raises(InputError, match="^Run.to_frame needs pandas: pip install pandas$"):
        run.to_frame()
