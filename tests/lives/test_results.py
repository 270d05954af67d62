"""Results: cohorts collected and merged, so that rows, curves and networks stay aligned."""

import copy
import dataclasses

import numpy as np
import pytest
from helpers import same_results
from hypothesis import given, settings
from hypothesis import strategies as st

from musebot.protocols.lives.conditions import PAPER_TASKS, CohortKey, Condition
from musebot.protocols.lives.experiment import Experiment
from musebot.protocols.lives.run import (
    WHEN,
    ConditionResults,
    Lives,
    Robot,
    category_in,
    collect,
    merge,
)
from musebot.protocols.lives.schedules import SCHEDULES

quick = settings(deadline=None, max_examples=50)
CONDITIONS = [Condition(t, p) for t in PAPER_TASKS for p in ("fixed", "random", "creative")]
NAN = float("nan")
HIDDEN = "evaluation.hidden_biases"


def mark(condition, robot, run):
    """Returns a number that identifies a robot of a condition of a run."""
    return 10_000 * run + 100 * CONDITIONS.index(condition) + robot


def marked(lives, run):
    """Returns results whose rows, curves and networks hold the marks of their robots.

    Args:
      lives: Numbers of the robots of each condition.
      run: Number of the run, kept as the rows' seed.
    """
    results = {}
    for condition in CONDITIONS:
        if numbers := sorted(lives.get(condition, ())):
            marks = np.array([mark(condition, n, run) for n in numbers], dtype=np.float32)
            unmeasured = SCHEDULES[condition.task].unmeasured
            robots = [
                Robot(
                    condition.task, condition.proposer, run, n, n, 1.0, float(m),
                    *((NAN, unmeasured) if n % 3 == 0 else (-0.5, "L < 0")),
                )
                for n, m in zip(numbers, marks, strict=True)
            ]  # fmt: skip
            networks = {when: {HIDDEN: marks[:, None, None] + 0.5} for when in WHEN}
            results[condition] = ConditionResults(
                robots, np.stack([marks, marks], axis=1), networks
            )
    return results


lives = st.dictionaries(
    st.sampled_from(CONDITIONS), st.sets(st.integers(0, 12), min_size=1), max_size=4
)


# Merging


@quick
@given(lives, lives)
def test_merged_results_hold_every_robot_once_in_the_order_of_the_tables(older, newer):
    merged = merge(marked(older, 1), marked(newer, 2))
    assert [*merged] == [c for c in CONDITIONS if c in older or c in newer]
    for condition, part in merged.items():
        wanted = sorted(older.get(condition, set()) | newer.get(condition, set()))
        assert [robot.robot for robot in part.robots] == wanted
        assert all(
            (robot.task, robot.proposer) == (condition.task, condition.proposer)
            for robot in part.robots
        )


@quick
@given(lives, lives)
def test_a_robot_that_both_have_is_taken_whole_from_the_older(older, newer):
    merged = merge(marked(older, 1), marked(newer, 2))
    for condition, part in merged.items():
        marks = []
        for row in part.robots:
            assert row.seed == (1 if row.robot in older.get(condition, ()) else 2)
            marks.append(mark(condition, row.robot, row.seed))
        assert [row.t_post_s for row in part.robots] == marks
        assert part.curves.tolist() == [[m, m] for m in marks]
        for when in WHEN:
            assert part.networks[when].keys() == {HIDDEN}
            assert part.networks[when][HIDDEN].tolist() == [[[m + 0.5]] for m in marks]


@quick
@given(lives)
def test_merging_with_nothing_or_with_itself_changes_nothing(some):
    results = marked(some, 1)
    assert same_results(merge(results, {}), results)
    assert same_results(merge({}, results), results)
    assert same_results(merge(results, results), results)


@quick
@given(lives, lives, lives)
def test_the_number_of_steps_in_which_robots_are_added_does_not_matter(first, second, third):
    a, b, c = marked(first, 1), marked(second, 2), marked(third, 3)
    assert same_results(merge(merge(a, b), c), merge(a, merge(b, c)))


@quick
@given(lives, lives)
def test_merging_leaves_its_arguments_alone(older, newer):
    results = marked(older, 1), marked(newer, 2)
    before = copy.deepcopy(results)
    merge(*results)
    assert all(same_results(*pair) for pair in zip(results, before, strict=True))


@quick
@given(lives, st.integers(0, 12))
def test_rows_of_a_condition_keep_curves_and_networks_aligned(some, robot):
    for condition, part in marked(some, 1).items():
        which = np.array([i for i, row in enumerate(part.robots) if row.robot >= robot], dtype=int)
        chosen = part.rows(which)
        marks = [mark(condition, row.robot, 1) for row in chosen.robots]
        assert [row.robot for row in chosen.robots] == [
            row.robot for row in part.robots if row.robot >= robot
        ]
        assert chosen.curves[:, 0].tolist() == marks
        assert all(len(chosen.networks[when][HIDDEN]) == len(marks) for when in WHEN)


# Collecting

SHORT = Experiment(seed=9, cohort_size=2, time_scale=0.011)  # 1,056 steps: 1.76 minutes


def cohort(task, proposer, index):
    return CohortKey(Condition(task, proposer), index)


def no_minutes(task):
    """Returns the counts of a cohort whose event never happened in training."""
    return np.zeros((2, len(SHORT.schedule(task).steps_of_minutes())), dtype=np.int16)


def finished(pre, post, valid=(True, True), minutes=None, brain=0.0):
    """Returns what a cohort of two robots leaves, from its control steps with the event."""
    events = np.array([pre, (0, 0), post]).T
    minutes = no_minutes("wall_avoidance") if minutes is None else np.array(minutes)
    networks = {"evaluation.output_biases": np.full((2, 1), brain, dtype=np.float32)}
    after = {name: array + 0.5 for name, array in networks.items()}
    return Lives(events.astype(np.int32), minutes, np.array(valid), networks, after)


def test_finished_cohorts_become_rows():
    results = collect(
        SHORT,
        [
            (cohort("wall_avoidance", "random", 1), finished((30, 0), (10, 0))),
            (cohort("wall_avoidance", "random", 0), finished((7, 9), (0, 9), (True, False))),
            (
                cohort("spot_finding", "random", 0),
                finished((0, 30), (0, 10), minutes=no_minutes("spot_finding")),
            ),
            (cohort("wall_avoidance", "fixed", 0), finished((0, 5), (3, 5))),
        ],
    )
    robots = [robot for part in results.values() for robot in part.robots]
    assert [dataclasses.astuple(r)[:-2] for r in robots] == [
        ("wall_avoidance", "fixed", 9, 0, 0, 0.0, 0.3),
        ("wall_avoidance", "fixed", 9, 0, 1, 0.5, 0.5),
        ("wall_avoidance", "random", 9, 0, 0, 0.7, 0.0),
        ("wall_avoidance", "random", 9, 0, 1, 0.9, 0.9),
        ("wall_avoidance", "random", 9, 1, 2, 3.0, 1.0),
        ("wall_avoidance", "random", 9, 1, 3, 0.0, 0.0),
        ("spot_finding", "random", 9, 0, 0, 0.0, 0.0),
        ("spot_finding", "random", 9, 0, 1, 3.0, 1.0),
    ]
    abilities = [r.learn_ability for r in robots]
    assert abilities == pytest.approx([-1, 0, 1, NAN, 0.5, NAN, NAN, -0.5], nan_ok=True)
    assert [r.category for r in robots] == [
        *("L < 0", "L = 0", "L = 1", "invalid", "0 < L < 1", "genius", "ignorant", "L < 0")
    ]
    assert [r.valid for r in robots] == [r.category != "invalid" for r in robots]


def test_conditions_are_collected_in_the_order_of_the_tables():
    keys = [cohort(c.task, c.proposer, 0) for c in (CONDITIONS[4], CONDITIONS[1], CONDITIONS[3])]
    results = collect(
        SHORT,
        [(key, finished((0, 0), (0, 0), minutes=no_minutes(key.condition.task))) for key in keys],
    )
    assert [*results] == [CONDITIONS[1], CONDITIONS[3], CONDITIONS[4]]


def test_curves_are_shares_of_each_minute_even_of_a_last_one_cut_short():
    steps = sum(SHORT.schedule("wall_avoidance").steps())
    assert 600 < steps < 1200
    minutes = [[600, steps - 600], [150, 0]]
    key = cohort("wall_avoidance", "fixed", 0)
    results = collect(SHORT, [(key, finished((0, 0), (0, 0), minutes=minutes))])
    np.testing.assert_allclose(results[key.condition].curves, [[1, 1], [0.25, 0]])


def test_curves_and_networks_of_cohorts_stand_in_the_order_of_their_rows():
    results = collect(
        SHORT,
        [
            (
                cohort("wall_avoidance", "fixed", index),
                finished((0, 0), (0, 0), minutes=[[60 * index, 0], [60 * index, 0]], brain=index),
            )
            for index in (2, 0, 1)
        ],
    )
    (part,) = results.values()
    assert [robot.robot for robot in part.robots] == [0, 1, 2, 3, 4, 5]
    np.testing.assert_allclose(part.curves[:, 0], [0, 0, 0.1, 0.1, 0.2, 0.2], rtol=1e-6)
    assert part.curves.dtype == np.float32
    for when, more in (("before", 0), ("after", 0.5)):
        assert part.networks[when].keys() == {"evaluation.output_biases"}
        brains = part.networks[when]["evaluation.output_biases"]
        assert brains[:, 0].tolist() == [n + more for n in (0, 0, 1, 1, 2, 2)]


def test_a_robot_without_the_event_is_a_genius_or_an_ignorant():
    assert category_in("wall_avoidance", NAN) == "genius"
    assert category_in("spot_finding", NAN) == "ignorant"
    assert category_in("spot_finding", -0.5) == category_in("wall_avoidance", -0.5) == "L < 0"
