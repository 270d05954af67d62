"""Agents are made by their names; any agent is simulated, stopped and continued like a brain."""

import json
import re
import sys
from importlib.metadata import EntryPoint
from pathlib import Path

import pytest

from musebot.protocols.agents import factory as trusting
from musebot.protocols.agents import names
from musebot.protocols.agents.contract import check_agent
from musebot.protocols.agents.factory import factory_of, trust
from musebot.protocols.agents.names import RECORDED_NAMES, recorded_name, short_name
from musebot.protocols.cli import parser as cli
from musebot.protocols.errors import InputError
from musebot.protocols.runs.cohort import make_agent, random_streams
from musebot.protocols.runs.conditions import CohortKey, Condition
from musebot.protocols.runs.experiment import Experiment
from musebot.protocols.runs.run_files import read_run
from musebot.protocols.storage import read_json, write_json

GUIDE = Path(__file__).parents[2] / "docs" / "agents.md"
WALLS = "wall_avoidance"


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
    "dqn_no_replay": "musebot:dqn_no_replay",
    "dqn_l2": "musebot:dqn_l2",
    "dqn_shrink_perturb": "musebot:dqn_shrink_perturb",
    "dqn_continual": "musebot:dqn_continual",
    "dqn_centred": "musebot:dqn_centred",
    "hand_coded": "musebot.protocols.baselines:hand_coded",
    "newborn": "musebot:newborn",
}


def test_every_name_of_an_agent_of_ours_is_recorded_as_the_same():
    assert RECORDED_NAMES == RECORDED
    for name, recorded in RECORDED.items():
        factory = factory_of(name)
        code = f"{factory.__module__}:{name}"
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


def test_the_streams_of_an_agent_depend_on_its_recorded_name():
    for task, name, index, brains, world in (
        # Numbers that version 0.1 drew, before agents moved to modules of their own.
        (WALLS, "q_learner", 0, 1224422446278906331, 5640226469081146786),
        ("spot_finding", "musebot.protocols.ppo:ppo", 3, 6216940540376297096, 4770454849655423297),
    ):
        key = CohortKey(Condition(task, recorded_name(name)), index)
        seed, random = random_streams(1, key)
        assert (seed, random.integers(2**63)) == (brains, world)


# Code

MODULES = [
    ("no_such_module:x", "", "there is no agent no_such_module:x"),
    ("musebot.protocols.baselines:no_such", "", "there is no agent musebot.protocols.baselines:no"),
    ("builtins:print", "", "must return an Agent, got NoneType"),
    ("math:pi", "", "math:pi must be a factory of agents, got float"),
    ("half:make", "def make(:", r"half cannot be imported \(SyntaxError: .*half.py, line 1\)\)$"),
    ("half:make", "\nimport no_such", r"imported \(ModuleNotFoundError: .*, half.py line 2\)$"),
]


@pytest.mark.parametrize(("name", "code", "words"), MODULES)
def test_a_factory_that_is_missing_broken_or_none_is_refused(
    name, code, words, tmp_path, monkeypatch
):
    (tmp_path / "half.py").write_text(code)
    monkeypatch.syspath_prepend(tmp_path)
    trust(name)
    with pytest.raises(InputError, match=words):
        make_agent(Experiment(), Condition(WALLS, name), 1, 0)


# Trust

SPY = """
from pathlib import Path
from musebot.protocols.agents.learners.q_learning import q_learner
Path(__file__).with_name("ran").touch()
make = q_learner
"""


@pytest.fixture
def held(tmp_path, monkeypatch, commands_in_process):
    """Runs commands beside a run of an agent; returns their status and whether its code ran."""
    (tmp_path / "spy_agent.py").write_text(SPY)
    monkeypatch.chdir(tmp_path)
    words = f"run out --agent spy_agent:make --robots 2 --time-scale 0.001 --life {WALLS}"
    assert cli.main(words.split()) == 0
    sys.modules.pop("spy_agent")
    monkeypatch.setattr(trusting, "_TRUSTED", set())
    monkeypatch.setattr(sys, "path", [path for path in sys.path if path != str(tmp_path)])
    (tmp_path / "ran").unlink()

    def command(words):
        status = cli.main(words.split())
        sys.modules.pop("spy_agent", None)
        return status, (tmp_path / "ran").exists()

    return command


def test_an_agent_that_only_the_run_names_is_not_imported(held, capsys, tmp_path):
    before = (tmp_path / "out" / "experiment.json").read_bytes()
    plan = json.loads(before)
    plan["plan"][0]["robots"] = 4
    write_json(tmp_path / "out" / "experiment.json", plan)
    for words in ("run out", f"film --task {WALLS} --output a.mp4 out --proposer spy_agent:make"):
        capsys.readouterr()
        assert held(words) == (2, False)
        said = capsys.readouterr().err
        assert "names the agent spy_agent:make, whose code would be run: allow it by --ag" in said
    assert str(tmp_path) not in sys.path
    assert read_json(tmp_path / "out" / "experiment.json")["plan"] == plan["plan"]


@pytest.mark.parametrize("words", ["--trust-agent", "--agent spy_agent:make"])
def test_an_agent_is_imported_where_the_command_allows_it(held, words, tmp_path):
    assert held(f"run out {words} --robots 4") == (0, True)
    assert len(read_run(tmp_path / "out").robots(Condition(WALLS, "spy_agent:make"))) == 4


def test_the_finished_robots_of_an_agent_need_no_trust(held):
    assert held(f"run out --proposer fixed --life {WALLS}") == (0, False)
    assert held("tables out --compare out") == (0, False)


def test_the_guides_example_keeps_the_contract_is_simulated_and_stands_in_the_tables(
    tmp_path, monkeypatch, capsys, processes_that_have_imported
):
    [code] = re.findall(r"```python\n(.*?)```", GUIDE.read_text(), re.DOTALL)
    [shell] = re.findall(r"```sh\n(.*?)```", GUIDE.read_text(), re.DOTALL)
    (tmp_path / "my_agent.py").write_text(code)
    monkeypatch.chdir(tmp_path)
    check, *lines = shell.strip().splitlines()
    assert check == "musebot doctor --agent my_agent:table"
    assert check_agent("my_agent:table") == []
    sys.modules.pop("my_agent")
    for line in lines:
        words = line.removeprefix("musebot ").split()
        words = [{"20": "4", "0.01": "0.001"}.get(word, word) for word in words]  # to be quick
        assert cli.main(words) == 0
        assert "my_agent:table" in capsys.readouterr().out
