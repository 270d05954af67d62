"""Agents are made by their names; any agent is simulated, stopped and continued like a brain."""

import json
import re
import subprocess
import sys
from importlib.metadata import EntryPoint
from pathlib import Path

import pytest

from musebot.controller import PROPOSERS
from musebot.protocols.agents import factory as trusting
from musebot.protocols.agents import names
from musebot.protocols.agents.contract import check_agent
from musebot.protocols.agents.factory import factory_of, trust
from musebot.protocols.agents.names import RECORDED_NAMES, recorded_name, short_name
from musebot.protocols.agents.neurocontroller import NeurocontrollerAgent
from musebot.protocols.cli import parser as cli
from musebot.protocols.errors import InputError
from musebot.protocols.lives.cohort import make_agent, random_streams
from musebot.protocols.lives.conditions import CohortKey, Condition
from musebot.protocols.lives.experiment import Experiment
from musebot.protocols.lives.manifest import write_manifest
from musebot.protocols.lives.plan import Plan
from musebot.protocols.lives.run import Robot
from musebot.protocols.lives.run_files import read_run, write_results
from musebot.protocols.storage import read_json, write_json

GUIDE = Path(__file__).parents[2] / "docs" / "agents.md"
WALLS = "wall_avoidance"
REHEARSAL = "--robots 2 --time-scale 0.001 --body kinematic --task wall_avoidance".split()


@pytest.fixture(autouse=True)
def _nothing_is_trusted_before_or_after(monkeypatch):
    monkeypatch.setattr(trusting, "_TRUSTED", set())
    monkeypatch.setattr(sys, "path", [*sys.path])


# Names

# A kept run records these names, and the streams of its cohorts depend on them.
RECORDED = {
    "q_learner": "musebot.protocols.baselines:q_learner",
    "sarsa_lambda": "musebot:sarsa_lambda",
    "stream_q": "musebot:stream_q",
    "stream_ac": "musebot:stream_ac",
    "avg": "musebot:avg",
    "amortised_q": "musebot:amortised_q",
    "dqn": "musebot:dqn",
    "ppo": "musebot.protocols.ppo:ppo",
    "hand_coded": "musebot.protocols.baselines:hand_coded",
    "newborn": "musebot:newborn",
}


def test_every_name_of_an_agent_of_ours_is_recorded_as_the_same():
    assert RECORDED_NAMES == RECORDED
    for name, recorded in RECORDED.items():
        factory = factory_of(name)
        code = f"{factory.__module__}:{factory.__qualname__}"
        for given in (name, recorded, code):
            assert recorded_name(given) == recorded
            assert factory_of(recorded_name(given)) is factory
        assert short_name(recorded) == name


def test_other_packages_register_agents_but_take_no_name_of_ours(monkeypatch):
    points = [
        EntryPoint("mine", "package.module:make", names.GROUP),
        EntryPoint("avg", "evil:make", names.GROUP),
        EntryPoint("creative", "evil:make", names.GROUP),
    ]
    monkeypatch.setattr(names, "entry_points", lambda group: points if group == names.GROUP else [])
    names.registered_names.cache_clear()
    try:
        assert names.registered_names() == {"mine": "package.module:make"}
        assert recorded_name("mine") == "package.module:make"
        assert recorded_name("avg") == RECORDED["avg"] and recorded_name("creative") == "creative"
        assert names.short_name("package.module:make") == "mine"
        with pytest.raises(InputError, match="whose code would be run"):  # not imported unasked
            make_agent(Experiment(), Condition(WALLS, "package.module:make"), 2, 0)
    finally:
        names.registered_names.cache_clear()


def test_a_run_records_the_name_of_the_table(tmp_path, commands_in_process):
    assert cli.main(["run", str(tmp_path), "--agent", "q_learner", *REHEARSAL]) == 0
    assert read_run(tmp_path).conditions() == [Condition(WALLS, RECORDED["q_learner"])]


def test_the_streams_of_an_agent_depend_on_its_recorded_name():
    for task, name, index, brains, world in (
        # Numbers that version 0.1 drew, before agents moved to modules of their own.
        (WALLS, "q_learner", 0, 1224422446278906331, 5640226469081146786),
        ("spot_finding", "ppo", 3, 6216940540376297096, 4770454849655423297),
    ):
        key = CohortKey(Condition(task, recorded_name(name)), index)
        seed, random = random_streams(1, key)
        assert (seed, random.integers(2**63)) == (brains, world)


# Agents


def test_a_proposer_is_driven_by_a_neurocontroller():
    for proposer in PROPOSERS:
        agent = make_agent(Experiment(), Condition(WALLS, proposer), 2, 0)
        assert isinstance(agent, NeurocontrollerAgent)


def test_agents_observe_as_many_signals_as_the_task_has():
    walls = Experiment(protocol="walls")
    condition = Condition("spot_finding", RECORDED["q_learner"])
    agent = make_agent(walls, condition, 2, 0)
    assert agent.weights()["hidden_weights"].shape[2] == 6


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("no_such_module:x", "there is no agent no_such_module:x"),
        ("musebot.protocols.baselines:no_such", "there is no agent musebot.protocols.baselines:no"),
        ("builtins:print", "must return an Agent, got NoneType"),
        ("math:pi", "math:pi must be a factory of agents, got float"),
    ],
)
def test_a_missing_factory_and_one_that_makes_no_agent_are_refused(name, words):
    trust(name)
    with pytest.raises(InputError, match=words):
        make_agent(Experiment(), Condition(WALLS, name), 1, 0)


@pytest.mark.parametrize(
    ("code", "reason"),
    [
        ("def make(:", r"\(SyntaxError: .*half_written.py, line 1\)\)$"),
        ("\nimport no_such_package", r"\(ModuleNotFoundError: .*, half_written.py line 2\)$"),
    ],
)
def test_a_module_that_cannot_be_imported_is_refused_with_the_reason(
    code, reason, tmp_path, monkeypatch
):
    (tmp_path / "half_written.py").write_text(code)
    monkeypatch.syspath_prepend(tmp_path)
    trust("half_written:make")
    with pytest.raises(InputError, match="half_written cannot be imported " + reason):
        make_agent(Experiment(), Condition(WALLS, "half_written:make"), 1, 0)


# Trust

SPY = """
from pathlib import Path
from musebot.protocols.agents.learners.q_learning import q_learner
Path(__file__).with_name("ran").touch()
make = q_learner
"""


@pytest.fixture
def held(tmp_path, monkeypatch, commands_in_process):
    """A run with finished robots of an agent, and a command that grows it in the agent's folder."""
    (tmp_path / "spy_agent.py").write_text(SPY)
    monkeypatch.chdir(tmp_path)
    assert cli.main(["run", "out", "--agent", "spy_agent:make", *REHEARSAL]) == 0
    sys.modules.pop("spy_agent")
    monkeypatch.setattr(trusting, "_TRUSTED", set())
    monkeypatch.setattr(sys, "path", [path for path in sys.path if path != str(tmp_path)])
    (tmp_path / "ran").unlink()

    def run(*words):
        status = cli.main(["run", "out", *words])
        sys.modules.pop("spy_agent", None)
        return status, (tmp_path / "ran").exists()

    return run


def test_an_agent_that_only_the_run_names_is_not_imported(held, capsys, tmp_path):
    before = (tmp_path / "out" / "experiment.json").read_bytes()
    capsys.readouterr()
    plan = json.loads(before)
    plan["plan"][0]["robots"] = 4
    write_json(tmp_path / "out" / "experiment.json", plan)
    assert held() == (2, False)
    said = capsys.readouterr().err
    assert "names the agent spy_agent:make, whose code would be run: allow it by --agent" in said
    assert str(tmp_path) not in sys.path
    assert read_json(tmp_path / "out" / "experiment.json")["plan"] == plan["plan"]


@pytest.mark.parametrize("words", [["--trust-agent"], ["--agent", "spy_agent:make"]])
def test_an_agent_is_imported_where_the_command_allows_it(held, words, tmp_path):
    assert held(*words, "--robots", "4") == (0, True)
    assert len(read_run(tmp_path / "out").robots(Condition(WALLS, "spy_agent:make"))) == 4


def test_the_finished_robots_of_an_agent_need_no_trust(held):
    assert held("--proposer", "fixed", "--task", WALLS) == (0, False)


@pytest.fixture
def agents_of_a_run(tmp_path, monkeypatch, invented, commands_in_process):
    """The working directory, with an agent's module and a run of MuJoCo that names this agent."""
    (tmp_path / "spy_agent.py").write_text(SPY)
    monkeypatch.chdir(tmp_path)
    experiment, results = Experiment(cohort_size=2), {}
    for proposer in ("creative", "random", "spy_agent:make"):
        times = ((12.5, 0.0, 1.0, "L = 1"), (3.0, 3.0, 0.0, "L = 0"))
        rows = [Robot(WALLS, proposer, 1, 0, robot, *row) for robot, row in enumerate(times)]
        results[Condition(WALLS, proposer)] = invented(experiment, rows)
    write_manifest(tmp_path / "out", Plan(experiment, dict.fromkeys(results, 2)))
    write_results(tmp_path / "out", experiment, results)
    return tmp_path


def test_a_command_that_needs_no_agent_imports_none_of_a_run(agents_of_a_run):
    assert cli.main("tables out --compare out --json".split()) == 0
    assert "spy_agent" not in sys.modules and not (agents_of_a_run / "ran").exists()


def test_a_command_that_needs_an_agent_does_not_trust_the_name_in_a_run(agents_of_a_run, capsys):
    words = f"film out --task {WALLS} --proposer spy_agent:make --output film.mp4"
    assert cli.main(words.split()) == 2
    assert "names the agent spy_agent:make, whose code would be run" in capsys.readouterr().err
    assert "spy_agent" not in sys.modules and not (agents_of_a_run / "ran").exists()


# The example of docs/agents.md


def example():
    [code] = re.findall(r"```python\n(.*?)```", GUIDE.read_text(), re.DOTALL)
    return code


def test_the_guides_example_keeps_the_contract_is_simulated_and_stands_in_the_tables(
    tmp_path, monkeypatch
):
    [shell] = re.findall(r"```sh\n(.*?)```", GUIDE.read_text(), re.DOTALL)
    (tmp_path / "my_agent.py").write_text(example())
    monkeypatch.chdir(tmp_path)
    check, *lines = shell.strip().splitlines()
    assert check == "musebot doctor --agent my_agent:table"
    assert check_agent("my_agent:table") == []
    sys.modules.pop("my_agent")
    for line in lines:
        words = line.replace("musebot", f"{sys.executable} -m musebot", 1).split()
        words = [{"20": "4"}.get(word, word) for word in words]  # four robots, to be quick
        done = subprocess.run(words, cwd=tmp_path, capture_output=True, text=True)
        assert done.returncode == 0, done.stderr
        assert "my_agent:table" in done.stdout
