"""Conditions and cohorts: their names, their order, and which ones there are."""

import random

import pytest

from musebot.controller import PROPOSERS
from musebot.protocols.errors import InputError
from musebot.protocols.runs.conditions import CohortKey, Condition
from musebot.tasks.lives import LIVES

AGENTS = ("a.b:c", "z:y")
ORDERED = [Condition(life, p) for life in LIVES for p in (*PROPOSERS, *AGENTS)]


def test_conditions_and_cohorts_sort_as_the_papers_tables_with_agents_after_the_proposers():
    cohorts = [CohortKey(condition, index) for condition in ORDERED for index in (0, 2, 10)]
    for ordered in (ORDERED, cohorts):
        shuffled = [*ordered]
        random.Random(0).shuffle(shuffled)
        assert sorted(shuffled) == ordered
    assert [*LIVES][:2] == ["wall_avoidance", "spot_finding"]


def test_conditions_and_cohorts_have_names_and_equal_ones_are_one_key():
    assert str(Condition("spot_finding", "creative")) == "spot_finding/creative"
    assert str(Condition("wall_avoidance", "a.b:c")) == "wall_avoidance/a.b:c"
    assert str(CohortKey(Condition("spot_finding", "random"), 12)) == "spot_finding-random-0012"
    assert str(CohortKey(Condition("spot_finding", "a.b:c"), 3)) == "spot_finding-a.b.c-0003"
    assert len({Condition("spot_finding", "fixed"), Condition("spot_finding", "fixed")}) == 1
    assert {c.proposer for c in ORDERED if c.has_brain} == set(PROPOSERS)


def test_unknown_tasks_and_proposers_are_refused_and_factories_accepted():
    for name in ("Swim", "swim@0", "swim@", "../swim", "s" * 41):
        with pytest.raises(InputError, match="a life has a name such as wall_avoidance, .*, got"):
            Condition(name, "fixed")
    assert str(Condition("swim@12", "fixed")) == "swim@12/fixed"
    with pytest.raises(InputError, match=r"got 'creatve'; did you mean creative\?"):
        Condition("spot_finding", "creatve")
    with pytest.raises(InputError, match="must be one of fixed, random, creative, or .*'divine'"):
        Condition("spot_finding", "divine")
    for name in ("nonsense", "a.b", "a:b:c", "a b:c", ":x", "x:", "1a:b"):
        with pytest.raises(InputError, match="must be one of fixed, random, creative, or an agent"):
            Condition("spot_finding", name)
    with pytest.raises(InputError, match="an agent's name must have at most 150 bytes, got 'aaa"):
        Condition("spot_finding", f"{'a' * 149}:b")
    for name in (*PROPOSERS, "a:b", "a.b.c:d", "_a._b:_c", f"{'a' * 148}:b"):
        Condition("spot_finding", name)
