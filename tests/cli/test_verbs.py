"""The verbs that read a run, and the lists."""

import shutil

import pytest

from musebot.controller import BRAINS, PROPOSERS
from musebot.protocols.agents.factory import factory_of
from musebot.protocols.agents.names import RECORDED_NAMES
from musebot.protocols.agents.settings import settings_of
from musebot.protocols.cli import parser as cli
from musebot.protocols.cli.listing import NAMES
from musebot.protocols.pages import viewer
from musebot.protocols.runs.conditions import Condition
from musebot.protocols.runs.experiment import Experiment
from musebot.protocols.runs.plan import Plan
from musebot.protocols.runs.simulation import simulate
from musebot.tasks.arena import SUITE
from musebot.tasks.lives import LIVES


@pytest.fixture(scope="module")
def run(tmp_path_factory, in_process):
    directory = tmp_path_factory.mktemp("cli") / "run"
    conditions = (Condition("wall_avoidance", "fixed"), Condition("spot_finding", "creative"))
    plan = Plan.of(Experiment(cohort_size=2, time_scale=0.002), conditions, 2)
    simulate(directory, plan, in_process(), quiet=True)
    return directory


def test_tables_of_few_robots_stand_alone_and_name_a_rehearsal(run, capsys):
    assert cli.main(["tables", str(run)]) == 0
    text = capsys.readouterr().out
    assert "Wall avoidance (table 1), all durations times 0.002" in text
    assert "fewer than 20 robots" in text and "| fixed |" in text and "260 (52%)" not in text
    assert cli.main(["run", str(run)]) == 0  # finished: prints the same, and keeps it
    assert capsys.readouterr().out == text == (run / "tables.md").read_text()


def test_exact_classes_are_not_rounded(run, capsys):
    for words, rounded in (([], True), (["--exact-classes"], False)):
        assert cli.main(["tables", str(run), *words]) == 0
        assert ("L is rounded to two decimals" in capsys.readouterr().out) == rounded


def test_the_window_gets_the_robot_that_the_command_names(run, monkeypatch):
    opened = []
    monkeypatch.setattr(viewer, "explore", lambda *given: opened.append(given))
    words = f"explore spot_finding --out {run} --proposer creative --robot 1 --phase pre"
    assert cli.main(words.split()) == 0
    assert cli.main(["explore", "wall_avoidance", "--random"]) == 0
    (task, driver), other = opened
    assert (task, driver.name) == ("spot_finding", "creative, robot 1, pre-training")
    assert other == ("wall_avoidance", None)


def test_two_runs_are_compared_cell_by_cell_and_named_by_their_paths(run, tmp_path, capsys):
    copy = tmp_path / run.name
    shutil.copytree(run, copy)
    assert cli.main(["tables", str(run), "--compare", str(copy)]) == 0
    text = capsys.readouterr().out
    assert f"{run.parent.name}/{run.name}" in text and f"{tmp_path.name}/{run.name}" in text
    assert "After Holm's correction 0 of 18 cells differ." in text and "in pairs" in text


@pytest.mark.parametrize(
    ("words", "sentence"),
    [
        (["tables", "nowhere"], "there is no folder"),
        (["report", "nowhere"], "there is no folder"),
        (["report"], "missing: OUT"),
        (["film", "--task", "spot_finding", "--output", "x.txt"], "x.txt"),
        (["film", "nowhere", "--task", "spot_finding", "--output", "x.gif"], "nowhere"),
        (["explore", "--keys", "--random"], "only one of --out, --policy, --keys and --random"),
        (["explore", "wall_avoidance", "--proposer", "fixed"], "--proposer needs --out"),
        (["explore", "dancing"], "there is no task 'dancing'; there are "),
        (["explore", "spot_findng"], "there is no task 'spot_findng'; did you mean spot_finding"),
        (["list", "sarsa_lambd"], "did you mean sarsa_lambda"),
        (["list", "creative"], "creative is a proposer of the brain, which has no settings"),
        (["list", "nowhere:made"], "no module nowhere"),
        (["list", "feelings"], "there are lives, tasks, brains, agents"),
        (["doctor", "--set", "a=1"], "it needs --agent"),
    ],
)
def test_bad_input_is_one_sentence_and_nothing_is_made(
    words, sentence, tmp_path, capsys, monkeypatch
):
    monkeypatch.chdir(tmp_path)
    assert cli.main(words) == 2
    message = capsys.readouterr().err
    assert sentence in message and message.count("\n") == 1
    assert list(tmp_path.iterdir()) == []


def test_everything_with_a_name_is_listed_with_a_line(capsys):
    names = {
        "lives": LIVES, "tasks": {*SUITE}, "brains": BRAINS,
        "agents": (*PROPOSERS, *RECORDED_NAMES),
    }  # fmt: skip
    assert {kind: {*lines} for kind, lines in NAMES.items()} == {k: {*v} for k, v in names.items()}
    assert cli.main(["list"]) == 0
    text = capsys.readouterr().out
    for kind, lines in NAMES.items():
        assert cli.main(["list", kind]) == 0
        own = capsys.readouterr().out.splitlines()
        assert [line.split()[0] for line in own] == [*lines]
        assert all(line.endswith(".") and f"  {line}\n" in text for line in own)


@pytest.mark.parametrize("agent", RECORDED_NAMES)
def test_the_settings_of_an_agent_are_listed_with_default_limits_and_meaning(agent, capsys):
    assert cli.main(["list", agent]) == 0
    lines = capsys.readouterr().out.splitlines()
    settings = settings_of(factory_of(agent))
    assert [line.split()[0] for line in lines if settings] == [*settings]
    for line, one in zip(lines, settings.values(), strict=bool(settings)):
        assert [float(line.split()[place]) for place in (1, 2, 4)] == [
            one.default,
            one.low,
            one.high,
        ]
        assert one.says and line.endswith(one.says)
