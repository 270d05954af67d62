"""Plans: which robots are wanted, into which cohorts they split, and what memory they need."""

import dataclasses
import gzip

import pytest
from hypothesis import given
from hypothesis import strategies as st
from strategies import CONDITIONS, plans

from musebot.controller import BRAINS, Parameters
from musebot.protocols.agents.names import recorded_name
from musebot.protocols.errors import InputError
from musebot.protocols.runs import plan as module
from musebot.protocols.runs.conditions import CohortKey, Condition
from musebot.protocols.runs.experiment import Experiment
from musebot.protocols.runs.plan import Plan, check_memory, cohort_bytes, default_cohort_size
from musebot.protocols.runs.run import Robot
from musebot.protocols.runs.run_files import RESULTS_FILE, write_results
from musebot.protocols.runs.simulation import check_agents
from musebot.tasks.lives import Life, Phase

MEGABYTE = 2**20


def test_an_invalid_plan_is_refused_in_a_sentence():
    warp = Experiment(cohort_size=1, physics="warp")
    own = Life("own", "Own", "spot_finding_two_noses", (Phase(),))
    kinematic = Experiment(cohort_size=1, body="kinematic", life=own)
    body, nobody, noses = (Condition(life, "fixed") for life in ("body", "nobody", "own"))
    for conditions, robots, experiment, sentence in (
        ((), 50, Experiment(), "at least one task and one proposer are needed"),
        (CONDITIONS, 0, Experiment(), "a whole number from 1 to 1000000, got 0"),
        (CONDITIONS, 1_000_050, Experiment(), "from 1 to 1000000, got 1000050"),
        (CONDITIONS, True, Experiment(), "from 1 to 1000000, got True"),
        (CONDITIONS, 75, Experiment(), "must be a multiple of the cohort size, 50, got 75"),
        ([body], 1, warp, "body is simulated on CPUs only: its world changes"),
        ([noses], 1, kinematic, "the paper's robot and arena only, unlike spot_finding_two_noses"),
        ([nobody], 50, Experiment(), "there is no life 'nobody'; did you mean body?"),
    ):
        with pytest.raises(InputError) as caught:
            Plan.of(experiment, conditions, robots)
        assert sentence in str(caught.value)


# Cohorts


@given(plans())
def test_cohorts_hold_every_robot_once_in_the_order_of_the_plan_but_the_longest_lives_first(plan):
    size, life_of = plan.experiment.cohort_size, plan.experiment.life_of
    of_plan = [CohortKey(c, n) for c in plan.robots for n in range(plan.robots[c] // size)]
    assert plan.cohorts() == sorted(
        of_plan, key=lambda key: sum(life_of(key.condition.life).steps()), reverse=True
    )


@given(plans(), plans())
def test_a_merged_plan_asks_for_the_robots_of_both(plan, other):
    other = Plan.of(plan.experiment, other.robots, plan.experiment.cohort_size * 3)
    merged = plan.merged_with(other)
    assert set(merged.cohorts()) == {*plan.cohorts(), *other.cohorts()}
    assert [*merged.robots] == [c for c in CONDITIONS if c in {*plan.robots, *other.robots}]
    assert merged == other.merged_with(plan)


@given(st.integers(1, 5000), st.integers(1, 300))
def test_the_default_cohort_size_is_the_largest_divisor_up_to_the_most(robots, most):
    largest = max(size for size in range(1, min(most, robots) + 1) if robots % size == 0)
    if robots > most and largest < most / 10:
        with pytest.raises(InputError, match="do not split into a few equal cohorts"):
            default_cohort_size(robots, most=most)
    else:
        assert default_cohort_size(robots, most=most) == largest
    assert default_cohort_size(500, 300) == 100  # of several conditions


# Memory


@pytest.fixture
def memory(monkeypatch):
    """Sets the bytes of the machine's memory."""
    return lambda size: monkeypatch.setattr(module, "machine_bytes", lambda: size)


def test_the_estimate_is_right_within_a_factor_of_two():
    for size, changes, measured in (  # peak of a process beyond its imports, in [MB]
        (4000, {}, 97),
        (100, {"ideas": 1000}, 72),
        (100, {"memory_hidden": 1000}, 2213),
        (100, {"ideas": 1000, "evaluation_hidden": 300, "memory_hidden": 300}, 1330),
    ):
        brain = dataclasses.replace(BRAINS["steady"], **changes)
        experiment = Experiment(cohort_size=size, brain=brain)
        found = cohort_bytes(experiment, CONDITIONS[2]) / MEGABYTE
        assert measured / 2 < found < measured * 2


def test_what_is_usual_fits_a_small_machine_and_more_is_refused_in_a_sentence(memory):
    memory(1280 * MEGABYTE)
    for brain in BRAINS.values():
        check_memory(Plan.of(Experiment(cohort_size=250, brain=brain), CONDITIONS, 10_000))
    memory(4096 * MEGABYTE)
    for size, ideas, robots in ((100_000, 1000, 100_000), (100, 25, 1_000_000)):
        experiment = Experiment(cohort_size=size, brain=Parameters(ideas=ideas))
        with pytest.raises(InputError) as caught:
            check_memory(Plan.of(experiment, CONDITIONS, robots))
        assert str(caught.value).startswith(f"{6 * robots} robots in cohorts of {size}, ")
        assert str(caught.value).endswith(" GiB of memory; this machine has 4.0 GiB")


@pytest.mark.parametrize("robots", [100, 300])
def test_cohorts_that_run_at_a_time_need_their_memory_together(robots, memory):
    plan = Plan.of(Experiment(cohort_size=100), CONDITIONS, robots)
    each, results = module.job_bytes(plan), module.results_bytes(plan)
    assert each == max(cohort_bytes(plan.experiment, condition) for condition in CONDITIONS)
    for at_once in (1, 2, 5, 40):
        count = min(at_once, 6 * robots // 100)
        needed = results + count * each + (count - 1) * module._PROCESS
        memory(needed)
        check_memory(plan, at_once)
        memory(needed - 1)
        with pytest.raises(InputError, match=f", {count} at a time"):
            check_memory(plan, at_once)


def test_the_size_of_the_results_is_that_of_their_file_before_it_is_compressed(tmp_path, invented):
    experiment = Experiment(cohort_size=20, body="kinematic")
    rows = [Robot(c.life, c.proposer, 1, 0, 0, 0.0, 0.0, 0.0, "L = 0") for c in CONDITIONS]
    lives = {c: invented(experiment, 40 * [row]) for c, row in zip(CONDITIONS, rows, strict=True)}
    write_results(tmp_path, experiment, lives)
    size = len(gzip.decompress((tmp_path / RESULTS_FILE).read_bytes()))
    estimate = module.results_bytes(Plan.of(experiment, CONDITIONS, 40)) / module._COPIES
    assert size == pytest.approx(estimate, abs=15_000)


def test_an_agent_that_needs_more_memory_than_there_is_is_refused(memory):
    """DQN's memory has 50,000 transitions of a robot."""
    experiment, dqn = Experiment(cohort_size=100, body="kinematic"), recorded_name("dqn")
    plan = Plan.of(experiment, [Condition("spot_finding", dqn)], 100)
    check_agents(plan)
    memory(50 * MEGABYTE)
    with pytest.raises(InputError, match=r"spot_finding/.*dqn would need about 0\.[12]"):
        check_agents(plan)
