"""`musebot.run`: the command's options in Python."""

import dataclasses
import subprocess
import sys

import pytest

import musebot
from musebot.controller import BRAINS
from musebot.protocols.cli import run as module
from musebot.protocols.cli.run import RunCommand
from musebot.protocols.errors import InputError
from musebot.protocols.lives.conditions import Condition
from musebot.protocols.lives.config import Config
from musebot.protocols.lives.experiment import Experiment
from musebot.protocols.lives.plan import Plan
from musebot.protocols.lives.run import Run

SHORT = {"time_scale": 0.001, "body": "kinematic", "quiet": True}


def test_a_run_in_python_is_that_of_the_command(tmp_path, commands_in_process):
    options = {"task": "spot_finding", "proposer": ["creative", "random"], "robots": 2}
    settings = {"set": {"epsilon": 0.1, "fixed_motors": [0.0, 0.5]}, "brain": "steady"}
    run = musebot.run(tmp_path / "run", **SHORT, **options, **settings)
    assert isinstance(run, Run)
    assert run.conditions() == [Condition("spot_finding", name) for name in ("random", "creative")]
    brain = run.experiment.brain
    assert (brain.epsilon, brain.fixed_motors) == (0.1, (0.0, 0.5))
    assert brain.memory_hidden == BRAINS["steady"].memory_hidden
    again = musebot.run(str(tmp_path / "run"))
    assert repr(again) == repr(run)  # NaN is unequal to itself


def test_load_run_reads_the_robots_of_a_folder_and_makes_no_other(tmp_path, commands_in_process):
    run = musebot.run(tmp_path / "run", **SHORT, task="spot_finding", proposer="fixed", robots=2)
    before = {path: path.read_bytes() for path in (tmp_path / "run").iterdir()}
    again = musebot.load_run(str(tmp_path / "run"))
    assert repr(again) == repr(run) and again.robots(run.conditions()[0])
    assert {path: path.read_bytes() for path in (tmp_path / "run").iterdir()} == before


def test_load_run_of_a_folder_without_a_run_is_one_sentence_and_makes_nothing(tmp_path):
    with pytest.raises(InputError, match="there is no folder .*nowhere"):
        musebot.load_run(tmp_path / "nowhere")
    with pytest.raises(InputError, match="holds no experiment"):
        musebot.load_run(tmp_path)
    assert [*tmp_path.iterdir()] == []


CHANGED = {
    "seed": 7, "cohort_size": 2, "protocol": "walls", "time_scale": 0.5, "nose": "printed",
    "nose_place": "centre", "body": "kinematic", "physics": "warp", "device": "cuda",
    "signals": "raw", "arena_scale": 1.5, "motor_speed": 0.1, "motor_torque": "scaled",
    "brain": "steady",
}  # fmt: skip


@pytest.mark.parametrize("name", CHANGED)
def test_every_option_of_an_experiment_reaches_it(name, tmp_path):
    more = {"body": "kinematic"} if name == "device" else {}
    command = RunCommand(tmp_path / "run", robots=2, **more, **{name: CHANGED[name]})
    found = command._plan(None, Config()).experiment
    assert getattr(found, "brain_name" if name == "brain" else name) == CHANGED[name]


def test_the_options_above_are_all_fields_of_an_experiment_that_the_command_has():
    options = {field.name for field in dataclasses.fields(RunCommand)}
    fields = {field.name for field in dataclasses.fields(Experiment)}
    # Parameters are given by words: settings, kinematics; a setting of tests is no option.
    assert {*CHANGED} == (options & fields) - {"kinematics"} == {*module._FIELDS}


@pytest.mark.parametrize(
    ("options", "planned"),
    [
        ({"task": ("spot_finding",)}, [("spot_finding", "random", 4)]),
        ({"proposer": ("fixed",)}, [("wall_avoidance", "fixed", 4)]),
        ({"agent": ("dqn",), "robots": 2}, [("wall_avoidance", "musebot:dqn", 2)]),
        ({}, [("wall_avoidance", "random", 4)]),
    ],
)
def test_tasks_and_proposers_that_are_not_given_are_those_of_the_run(tmp_path, options, planned):
    held = Plan.of(Experiment(cohort_size=2), [Condition("wall_avoidance", "random")], 4)
    plan = RunCommand(tmp_path / "run", **options)._plan(held, Config())
    assert [(c.task, c.proposer, n) for c, n in plan.robots.items()] == planned


def test_a_task_alone_has_the_proposers_that_the_run_has_in_it(tmp_path):
    both = [Condition("wall_avoidance", "fixed"), Condition("spot_finding", "creative")]
    held = Plan.of(Experiment(cohort_size=2), both, 4)
    for options, only in (
        ({"task": ("spot_finding",)}, both[1]),
        ({"proposer": ("fixed",)}, both[0]),
    ):
        plan = RunCommand(tmp_path / "run", robots=6, **options)._plan(held, Config())
        assert plan.robots == {only: 6}


def test_an_unknown_option_is_refused_with_all_names(tmp_path):
    with pytest.raises(TypeError, match="takes the options address, agent, .*, got robot$"):
        musebot.run(tmp_path / "run", robot=2)
    with pytest.raises(InputError, match="out must name a folder"):
        musebot.run("")
    for wrong in ({"robots": "2"}, {"robots": 0}, {"processes": 0}, {"brain": "divine"}):
        with pytest.raises(InputError):
            musebot.run(tmp_path / "run", **wrong)
    assert not (tmp_path / "run").exists()


SCRIPT = """
import musebot

print("read")
run = musebot.run("out", robots=2, task="wall_avoidance", proposer="fixed", time_scale=0.001,
                  body="kinematic", processes=1)
print(len(run.robots(run.conditions()[0])))
"""


@pytest.mark.slow
def test_a_script_without_the_main_guard_simulates_once(tmp_path):
    (tmp_path / "script.py").write_text(SCRIPT)
    done = subprocess.run(
        [sys.executable, "script.py"], cwd=tmp_path, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    assert done.stdout.split() == ["read", "2"]
    assert "100.0 %, 2 of 2 robots done" in done.stderr


def test_a_script_that_is_also_its_agents_module_is_asked_for_the_guard(
    tmp_path, monkeypatch, commands_in_process
):
    (tmp_path / "both_agent_and_script.py").write_text(
        "import musebot\nmusebot.run('out', agent='both_agent_and_script:make', robots=1)\n"
    )
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", [*sys.path])
    with pytest.raises(InputError, match='put the call below if __name__ == "__main__":'):
        musebot.run("out", agent="both_agent_and_script:make", robots=1, **SHORT)
    assert not module._running and not (tmp_path / "out").exists()
