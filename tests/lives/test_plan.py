"""Plans: which robots are wanted, and into which cohorts they split."""

import dataclasses

import pytest
from hypothesis import given
from hypothesis import strategies as st
from strategies import CONDITIONS, plans, quick

from musebot.protocols.errors import InputError
from musebot.protocols.lives.conditions import CohortKey, Condition
from musebot.protocols.lives.experiment import Experiment
from musebot.protocols.lives.plan import Plan, default_cohort_size


@pytest.mark.parametrize(
    ("conditions", "robots", "sentence"),
    [
        ((), 50, "at least one task and one proposer are needed"),
        (CONDITIONS, 0, "robots must be a whole number from 1 to 1000000, got 0"),
        (CONDITIONS, 10**9, "robots must be a whole number from 1 to 1000000, got 1000000000"),
        (CONDITIONS, True, "robots must be a whole number from 1 to 1000000, got True"),
        (CONDITIONS, 75, "robots must be a multiple of the cohort size, 50, got 75"),
    ],
)
def test_an_invalid_plan_is_refused_in_a_sentence(conditions, robots, sentence):
    with pytest.raises(InputError) as caught:
        Plan.of(Experiment(cohort_size=50), conditions, robots)
    assert sentence in str(caught.value)


def test_a_plan_has_only_tasks_of_its_protocol():
    experiment = Experiment(cohort_size=1, protocol="walls")
    assert Plan.of(experiment, [Condition("spot_finding", "fixed")], 1).conditions
    with pytest.raises(InputError, match="the protocol walls has only spot_finding, got wall_"):
        Plan.of(experiment, CONDITIONS, 1)


@quick
@given(plans())
def test_cohorts_hold_every_robot_once_and_the_longest_lives_come_first(plan):
    keys = plan.cohorts()
    assert len(set(keys)) == len(keys)
    assert len(keys) * plan.experiment.cohort_size == sum(plan.robots.values())
    assert {key.condition for key in keys} == set(plan.conditions)
    lengths = [sum(plan.experiment.schedule(key.condition.task).steps()) for key in keys]
    assert lengths == sorted(lengths, reverse=True)


def test_cohorts_of_equally_long_lives_keep_the_order_of_the_plan():
    plan = Plan(Experiment(cohort_size=2), dict.fromkeys(reversed(CONDITIONS[:3]), 4))
    wanted = [CohortKey(condition, index) for condition in CONDITIONS[2::-1] for index in (0, 1)]
    assert plan.cohorts() == wanted


@quick
@given(plans(), st.integers(1, 5))
def test_more_robots_are_more_cohorts(plan, more):
    extra = more * plan.experiment.cohort_size
    robots = {condition: count + extra for condition, count in plan.robots.items()}
    larger = dataclasses.replace(plan, robots=robots)
    assert set(plan.cohorts()) < set(larger.cohorts())


@quick
@given(plans(), plans())
def test_a_merged_plan_asks_for_the_robots_of_both(plan, other):
    other = Plan.of(plan.experiment, other.conditions, plan.experiment.cohort_size * 3)
    merged = plan.merged_with(other)
    assert set(merged.cohorts()) == {*plan.cohorts(), *other.cohorts()}
    assert merged.conditions == tuple(
        c for c in CONDITIONS if c in {*plan.conditions, *other.conditions}
    )
    assert merged == other.merged_with(plan)


def test_plans_of_two_experiments_do_not_merge():
    first, second = (Plan.of(Experiment(seed=seed), CONDITIONS, 50) for seed in (1, 2))
    with pytest.raises(InputError, match="two experiments cannot be merged"):
        first.merged_with(second)


@quick
@given(st.integers(1, 5000), st.integers(1, 300))
def test_the_default_cohort_size_is_the_largest_divisor_up_to_the_most(robots, most):
    largest = max(size for size in range(1, min(most, robots) + 1) if robots % size == 0)
    if robots > most and largest < most / 10:
        with pytest.raises(InputError, match="do not split into a few equal cohorts"):
            default_cohort_size(robots, most=most)
    else:
        assert default_cohort_size(robots, most=most) == largest


def test_cohorts_divide_the_robots_of_all_conditions():
    assert default_cohort_size(500, 300) == 100
    with pytest.raises(
        InputError, match="499 and 500 robots do not split .* larger common divisor"
    ):
        default_cohort_size(500, 499)


def test_500_robots_are_two_cohorts_and_60_are_one():
    assert default_cohort_size(500) == 250
    assert default_cohort_size(60) == 60
