"""Conditions and cohorts: their names, their order, and which ones there are."""

import random

import pytest

from musebot.controller import PROPOSERS
from musebot.protocols.errors import InputError
from musebot.protocols.lives.conditions import (
    PAPER_TASKS,
    CohortKey,
    Condition,
    check_proposer,
)

AGENTS = ("a.b:c", "z:y")
ORDERED = [Condition(task, p) for task in PAPER_TASKS for p in (*PROPOSERS, *AGENTS)]


def test_conditions_sort_as_the_papers_tables_with_agents_by_name_after_the_proposers():
    shuffled = [*ORDERED]
    random.Random(0).shuffle(shuffled)
    assert sorted(shuffled) == ORDERED
    assert PAPER_TASKS == ("wall_avoidance", "spot_finding")


def test_the_name_of_a_condition_is_its_task_and_its_proposer():
    assert str(Condition("spot_finding", "creative")) == "spot_finding/creative"
    assert str(Condition("wall_avoidance", "a.b:c")) == "wall_avoidance/a.b:c"


def test_equal_conditions_are_one_key():
    assert len({Condition("spot_finding", "fixed"), Condition("spot_finding", "fixed")}) == 1


def test_only_the_papers_proposers_have_a_brain():
    assert {c.proposer for c in ORDERED if c.has_brain} == set(PROPOSERS)


def test_the_name_of_a_cohort_is_its_condition_and_its_number():
    assert str(CohortKey(Condition("spot_finding", "random"), 12)) == "spot_finding-random-0012"
    assert str(CohortKey(Condition("spot_finding", "a.b:c"), 3)) == "spot_finding-a.b.c-0003"


def test_cohorts_sort_by_condition_and_then_by_number():
    ordered = [CohortKey(condition, index) for condition in ORDERED for index in (0, 2, 10)]
    shuffled = [*ordered]
    random.Random(0).shuffle(shuffled)
    assert sorted(shuffled) == ordered


def test_an_unknown_task_is_refused():
    with pytest.raises(InputError) as caught:
        Condition("swimming", "fixed")
    assert str(caught.value) == (
        "the task must be one of wall_avoidance, spot_finding, got 'swimming': lives have the "
        "paper's tasks only"
    )


def test_an_unknown_proposer_is_refused():
    with pytest.raises(InputError) as caught:
        Condition("spot_finding", "divine")
    assert str(caught.value) == (
        "the proposer must be one of fixed, random, creative, or an agent's factory as "
        "package.module:factory, got 'divine'"
    )


@pytest.mark.parametrize("name", ["nonsense", "a.b", "a:b:c", "a b:c", ":x", "x:", "1a:b"])
def test_a_name_that_is_not_the_form_of_a_factory_is_refused(name):
    with pytest.raises(InputError, match="must be one of fixed, random, creative, or an agent's"):
        check_proposer(name)


@pytest.mark.parametrize("name", [*PROPOSERS, "a:b", "a.b.c:d", "_a._b:_c"])
def test_proposers_and_factories_are_accepted(name):
    check_proposer(name)
