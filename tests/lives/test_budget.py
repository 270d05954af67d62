"""What a plan needs is known before it is begun."""

import dataclasses

import pytest

from musebot.controller import BRAINS, PROPOSERS, Parameters
from musebot.protocols.agents.names import recorded_name
from musebot.protocols.errors import InputError
from musebot.protocols.lives import budget
from musebot.protocols.lives.conditions import PAPER_TASKS, Condition
from musebot.protocols.lives.experiment import Experiment
from musebot.protocols.lives.plan import Plan
from musebot.protocols.lives.run import Robot
from musebot.protocols.lives.run_files import RESULTS_FILE, write_results
from musebot.protocols.lives.runs import check_agents

MEGABYTE = 2**20
CREATIVE = Condition("wall_avoidance", "creative")
ALL = [Condition(task, proposer) for task in PAPER_TASKS for proposer in PROPOSERS]


def memory(monkeypatch, size):
    monkeypatch.setattr(budget, "machine_bytes", lambda: size)


@pytest.mark.parametrize(
    ("size", "changes", "measured"),  # peak of a process beyond its imports, in [MB]
    [
        (4000, {}, 97),
        (100, {"ideas": 1000}, 72),
        (100, {"memory_hidden": 1000}, 2213),
        (100, {"ideas": 1000, "evaluation_hidden": 300, "memory_hidden": 300}, 1330),
    ],
)
def test_the_estimate_is_right_within_a_factor_of_two(size, changes, measured):
    brain = dataclasses.replace(BRAINS["steady"], **changes)
    found = budget.cohort_bytes(Experiment(cohort_size=size, brain=brain), CREATIVE) / MEGABYTE
    assert measured / 2 < found < measured * 2


def test_what_is_usual_fits_a_small_machine(monkeypatch):
    memory(monkeypatch, 1280 * MEGABYTE)
    for brain in BRAINS.values():
        budget.check_memory(Plan.of(Experiment(cohort_size=250, brain=brain), ALL, 10_000))


@pytest.mark.parametrize(
    "plan",
    [
        Plan.of(Experiment(cohort_size=100_000, brain=Parameters(ideas=1000)), ALL, 100_000),
        Plan.of(Experiment(cohort_size=100), ALL, 1_000_000),
    ],
)
def test_more_than_the_machine_has_is_refused_in_a_sentence(plan, monkeypatch):
    memory(monkeypatch, 4096 * MEGABYTE)
    with pytest.raises(InputError) as caught:
        budget.check_memory(plan)
    words = f"{sum(plan.robots.values())} robots in cohorts of {plan.experiment.cohort_size}, "
    assert str(caught.value).startswith(words)
    assert str(caught.value).endswith(" GiB of memory; this machine has 4.0 GiB")


@pytest.mark.parametrize("robots", [100, 300])
def test_cohorts_that_run_at_a_time_need_their_memory_together(robots, monkeypatch):
    plan = Plan.of(Experiment(cohort_size=100), ALL, robots)
    each, results = budget.job_bytes(plan), budget.results_bytes(plan)
    cohorts = 6 * robots // 100
    for at_once in (1, 2, 5, 40):
        count = min(at_once, cohorts)
        needed = results + count * each + (count - 1) * budget._PROCESS
        memory(monkeypatch, needed)
        budget.check_memory(plan, at_once)
        memory(monkeypatch, needed - 1)
        with pytest.raises(InputError, match=f", {count} at a time"):
            budget.check_memory(plan, at_once)


def test_jobs_on_tensors_have_all_conditions_of_a_task():
    experiment = Experiment(cohort_size=100, physics="warp")
    each = {task: 0 for task in PAPER_TASKS}
    for condition in ALL:
        each[condition.task] += budget.cohort_bytes(experiment, condition)
    assert budget.job_bytes(Plan.of(experiment, ALL, 200)) == max(each.values())


def test_the_size_of_the_results_is_that_of_their_file(tmp_path, invented):
    experiment = Experiment(cohort_size=20, body="kinematic")
    plan = Plan.of(experiment, ALL, 40)
    lives = {}
    for condition in ALL:
        row = Robot(condition.task, condition.proposer, 1, 0, 0, 0.0, 0.0, 0.0, "L = 0")
        lives[condition] = invented(experiment, 40 * [row])
    write_results(tmp_path, experiment, lives)
    size = (tmp_path / RESULTS_FILE).stat().st_size
    assert size == pytest.approx(budget.results_bytes(plan) / budget._COPIES, abs=15_000)


def test_an_agent_that_needs_more_memory_than_there_is_is_refused(monkeypatch):
    """DQN's memory has 50,000 transitions of a robot."""
    experiment, dqn = Experiment(cohort_size=100, body="kinematic"), recorded_name("dqn")
    plan = Plan.of(experiment, [Condition("spot_finding", dqn)], 100)
    check_agents(plan)
    memory(monkeypatch, 50 * 2**20)
    with pytest.raises(InputError, match=r"spot_finding/.*dqn would need about 0\.[12]"):
        check_agents(plan)


def test_the_machine_has_some_memory():
    assert 2**28 < budget.machine_bytes() < 2**50
