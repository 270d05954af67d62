"""`musebot.run`: the command's options in Python."""

import subprocess
import sys

import pytest

import musebot
from musebot.controller import BRAINS
from musebot.protocols.commands import run as module
from musebot.protocols.errors import InputError
from musebot.protocols.experiment.conditions import Condition
from musebot.protocols.results.run import Run

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


def test_an_unknown_option_is_refused_with_all_names(tmp_path):
    with pytest.raises(TypeError, match="takes the options address, agent, .*, got robot$"):
        musebot.run(tmp_path / "run", robot=2)
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
