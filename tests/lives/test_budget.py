"""What a plan needs is known before it is begun."""

import dataclasses

import pytest

from musebot.controller import BRAINS, PROPOSERS, Parameters
from musebot.protocols.agents.names import recorded_name
from musebot.protocols.cli import parser as cli
from musebot.protocols.errors import InputError
from musebot.protocols.lives import budget
from musebot.protocols.lives.cohort import check_agents
from musebot.protocols.lives.conditions import PAPER_TASKS, Condition
from musebot.protocols.lives.experiment import Experiment
from musebot.protocols.lives.plan import Plan
from musebot.protocols.lives.run_files import BRAINS_FILE
from musebot.protocols.lives.runs import simulate

MEGABYTE = 2**20
CREATIVE = Condition("wall_avoidance", "creative")
ALL = [Condition(task, proposer) for task in PAPER_TASKS for proposer in PROPOSERS]


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
    experiment = Experiment(
        cohort_size=size, brain=dataclasses.replace(BRAINS["steady"], **changes)
    )
    found = budget.cohort_bytes(experiment, CREATIVE) / MEGABYTE
    assert measured / 2 < found < measured * 2


def test_what_is_usual_fits_a_small_machine(monkeypatch):
    monkeypatch.setattr(budget, "machine_bytes", lambda: 1280 * MEGABYTE)
    for brain in BRAINS.values():
        budget.check_memory(Plan.of(Experiment(cohort_size=250, brain=brain), ALL, 10_000))


@pytest.mark.parametrize(
    ("plan", "words"),
    [
        (
            Plan.of(Experiment(cohort_size=100_000, brain=Parameters(ideas=1000)), ALL, 100_000),
            "a cohort of wall_avoidance/random would need about ",
        ),
        (Plan.of(Experiment(cohort_size=100), ALL, 1_000_000), "6000000 robots would need about "),
    ],
)
def test_more_than_the_machine_has_is_refused_in_a_sentence(plan, words, monkeypatch):
    monkeypatch.setattr(budget, "machine_bytes", lambda: 4096 * MEGABYTE)
    with pytest.raises(InputError) as caught:
        budget.check_memory(plan)
    assert str(caught.value).startswith(words)
    assert str(caught.value).endswith(" GiB of memory; this machine has 4.0 GiB")


def test_jobs_on_tensors_have_all_conditions_of_a_task():
    """Two jobs, one for each cohort of a task, with its three conditions."""
    experiment = Experiment(cohort_size=100, physics="warp")
    (walls, spot) = budget.job_kinds(Plan.of(experiment, ALL, 200))
    assert walls.what == "a cohort of wall_avoidance" and walls.jobs == spot.jobs == 2
    each = [budget.cohort_bytes(experiment, c) for c in ALL if c.task == "wall_avoidance"]
    assert walls.needed == sum(each)


def test_results_that_could_not_be_read_again_are_refused(monkeypatch):
    plan = Plan.of(Experiment(cohort_size=250), ALL, 10_000)
    largest = budget.brains_bytes(plan)
    monkeypatch.setattr(budget, "MOST_BYTES", largest)
    budget.check_memory(plan)
    monkeypatch.setattr(budget, "MOST_BYTES", largest - 1)
    with pytest.raises(InputError, match="^60000 robots would need a file of .* files may have"):
        budget.check_memory(plan)


def test_the_size_of_the_brains_is_that_of_their_file(tmp_path, in_process):
    plan = Plan.of(Experiment(cohort_size=4, time_scale=0.004, body="kinematic"), ALL, 8)
    simulate(tmp_path, plan, in_process(), quiet=True)
    size = (tmp_path / BRAINS_FILE).stat().st_size
    assert 0 <= size - budget.brains_bytes(plan) < 10_000  # names, shapes and the digest


def test_the_machine_has_some_memory():
    assert 2**28 < budget.machine_bytes() < 2**50


def test_an_agent_that_needs_more_memory_than_there_is_is_refused(monkeypatch):
    """DQN's memory has 50,000 transitions of a robot."""
    experiment, dqn = Experiment(cohort_size=100, body="kinematic"), recorded_name("dqn")
    plan = Plan.of(experiment, [Condition("spot_finding", dqn)], 100)
    check_agents(plan)
    monkeypatch.setattr(budget, "machine_bytes", lambda: 50 * 2**20)
    with pytest.raises(
        InputError, match=r"a cohort of spot_finding/.*dqn would need about 0\.[12]"
    ):
        check_agents(plan)


def test_cohorts_that_run_at_a_time_need_their_memory_together(monkeypatch, tmp_path, capsys):
    plan = Plan.of(Experiment(cohort_size=100), ALL, 300)
    each = sorted(
        (budget.cohort_bytes(plan.experiment, condition) for condition in ALL for _ in range(3)),
        reverse=True,
    )
    monkeypatch.setattr(budget, "results_bytes", lambda plan: 0)
    for at_once in (1, 2, 5, 18):
        processes = at_once * budget._PROCESS
        monkeypatch.setattr(
            budget, "machine_bytes", lambda n=at_once, p=processes: sum(each[:n]) + p
        )
        budget.check_memory(plan, at_once)
        if at_once < len(each):
            with pytest.raises(InputError, match=f"^{at_once + 1} cohorts at a time"):
                budget.check_memory(plan, at_once + 1)
    monkeypatch.setattr(budget, "machine_bytes", lambda: each[0] + budget._PROCESS)
    words = ["run", str(tmp_path / "out"), "--robots", "300", "--cohort-size", "100"]
    assert cli.main([*words, "--processes", "2"]) == 2
    assert "2 cohorts at a time (--processes) would need about" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()
