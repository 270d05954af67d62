"""A file instead of options: what it may hold, and what is refused."""

import json

import pytest

from musebot.controller import BRAINS, Parameters
from musebot.models import Kinematics
from musebot.protocols.cli import parser as cli
from musebot.protocols.cli.run import RunCommand
from musebot.protocols.errors import InputError
from musebot.protocols.lives.conditions import Condition
from musebot.protocols.lives.config import read_config
from musebot.protocols.lives.manifest import MANIFEST, read_manifest

EXAMPLE = """
experiment:
  seed: 7
  time_scale: 0.001
  body: kinematic
  kinematics: {wall: slides}
  brain: {name: steady, epsilon: 1e-1, fixed_motors: [0.0, 0.5]}
plan:
  - {task: wall_avoidance, proposer: fixed, robots: 2}
  - {task: spot_finding, proposer: creative, robots: 4}
"""
ROBOTS = {Condition("wall_avoidance", "fixed"): 2, Condition("spot_finding", "creative"): 4}


@pytest.fixture
def written(tmp_path):
    def written(text, name="run.yaml"):
        path = tmp_path / name
        path.write_text(text)
        return path

    return written


def test_a_file_gives_the_fields_and_the_robots_of_an_experiment(written):
    config = read_config(written(EXAMPLE))
    assert {*config.fields} == {"seed", "time_scale", "body", "kinematics", "brain"}
    brain = config.fields["brain"]
    assert (brain.epsilon, brain.fixed_motors) == (0.1, (0.0, 0.5))
    assert brain.learn_rate == BRAINS["steady"].learn_rate
    assert config.fields["kinematics"] == Kinematics(wall="slides")
    assert config.robots == {(c.task, c.proposer): n for c, n in ROBOTS.items()}


def test_a_brain_is_a_name_or_the_paper_s_with_changes(written):
    assert read_config(written("experiment: {brain: steady}")).fields == {"brain": BRAINS["steady"]}
    config = read_config(written("experiment: {brain: {noise: 0.5}}"))
    assert config.fields == {"brain": Parameters(noise=0.5)}


def test_a_file_is_simulated_and_an_option_comes_first(written, tmp_path, commands_in_process):
    path, out = written(EXAMPLE), tmp_path / "run"
    command = ["run", str(out), "--config", str(path)]
    assert cli.main([*command, "--seed", "9", "--set", "epsilon=0.2"]) == 0
    plan = read_manifest(out)
    assert plan.robots == ROBOTS and plan.experiment.cohort_size == 2
    experiment = plan.experiment
    assert (experiment.seed, experiment.time_scale) == (9, 0.001)
    assert (experiment.brain.epsilon, experiment.brain.fixed_motors) == (0.2, (0.0, 0.5))
    assert cli.main(command) == 2  # another seed
    command = ["run", str(tmp_path / "other"), "--config", str(path), "--robots", "1"]
    assert cli.main([*command, "--task", "spot_finding", "--proposer", "creative"]) == 0
    assert read_manifest(tmp_path / "other").robots == {Condition("spot_finding", "creative"): 1}


def test_the_manifest_of_a_run_gives_the_same_run_again(written, tmp_path, commands_in_process):
    first, again = tmp_path / "first", tmp_path / "again"
    short = "--robots 2 --time-scale 0.001 --body kinematic --proposer random --brain steady"
    assert cli.main(["run", str(first), *short.split()]) == 0
    content = json.loads((first / MANIFEST).read_text())
    content["experiment"]["course"] = content["experiment"].pop("protocol")  # an earlier version's
    brain = content["experiment"]["brain"]
    brain["centred"] = brain.pop("centred_inputs")
    path = written(json.dumps(content), "experiment.json")
    assert cli.main(["run", str(again), "--config", str(path)]) == 0
    assert read_manifest(again) == read_manifest(first)
    for name in ("robots.csv", "results.safetensors"):
        assert (again / name).read_bytes() == (first / name).read_bytes()


# Forty lists, each three times the one before: more text than there are atoms.
ALIASES = "experiment: [&a0 [x, x, x]" + "".join(
    f", &a{n} [*a{n - 1}, *a{n - 1}, *a{n - 1}]" for n in range(1, 40)
) + "]"  # fmt: skip


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (
            "seed: 1",
            "must be one of experiment, plan, physics, made_with, files, digest, got 'seed'",
        ),
        ("- 1", "must have the sections experiment and plan"),
        ("experiment: [1]", "experiment must be names with values, got [1]"),
        ("experiment: {soul: 1}", "a field of the experiment must be one of seed, cohort_size, "),
        ("experiment: {brain: {soul: 1}}", "a parameter of the brain must be one of evaluation_"),
        ("experiment: {brain: divine}", "brain must be one of paper, steady, "),
        ("experiment: {brain: {epsilon: 2}}", "epsilon must lie in [0, 1], got 2"),
        ("experiment: {brain: {name: [1]}}", "the brain's name must be a text, got [1]"),
        ("experiment: {brain: 3}", "brain must be names with values, got 3"),
        ("experiment: {kinematics: {tyre: flat}}", "a parameter of kinematics must be one of"),
        ("experiment: {seed: one}", "seed must be a whole number, got 'one'"),
        ("experiment: {seed: 1, seed: 2}", "seed is given twice"),
        ("experiment: {seed: 1", "cannot be read (while parsing"),
        ("experiment: {seed: !!bool perhaps}", "cannot be read"),
        ("experiment: {seed: !!int ''}", "cannot be read"),
        ("experiment: {seed: !!timestamp now}", "cannot be read"),
        ("experiment: !!python/object:os.system {}", "cannot be read (could not determine"),
        ("plan: {a: 1}", "plan must be a list of rows"),
        (
            "plan: [{task: spot_finding}]",
            "needs task, proposer, robots, got no proposer",
        ),
        (
            "plan: [{task: a, proposer: b, robots: 1, x: 1}]",
            "a row of the plan must be one of task",
        ),
        ("plan: [{task: dance, proposer: fixed, robots: 1}]", "task must be one of wall_"),
        (
            "plan: [{task: spot_finding, proposer: fixed, robots: two}]",
            "at least 1, got 'two'",
        ),
        ("plan: [{task: spot_finding, proposer: my:agent, robots: 1}]", "--trust-agent"),
        ("plan: [{task: [1], proposer: fixed, robots: 1}]", "must be texts, got [1] and 'fixed'"),
        (
            "plan: [{task: a, proposer: b, robots: 1}, {task: a, proposer: b, robots: 2}]",
            "a/b is planned twice",
        ),
        (
            "{experiment: {time_scale: 0.001, body: kinematic}, plan: ["
            "{task: spot_finding, proposer: dqn, robots: 1}, "
            "{task: spot_finding, proposer: musebot:dqn, robots: 1}]}",
            "spot_finding/musebot:dqn is planned twice",
        ),
        (ALIASES, "experiment must be names with values, got [["),
    ],
)
def test_a_wrong_file_is_one_sentence_and_nothing_is_made(text, words, written, tmp_path, capsys):
    path = written(text)
    assert cli.main(["run", str(tmp_path / "new"), "--config", str(path)]) == 2
    message = capsys.readouterr().err
    assert words in message and message.count("\n") == 1
    assert [*tmp_path.iterdir()] == [path]


def test_a_merge_key_of_yaml_adds_what_it_refers_to(written):
    config = read_config(written("experiment:\n  brain: {<<: {epsilon: 0.2}, ideas: 3}\n"))
    assert (config.fields["brain"].epsilon, config.fields["brain"].ideas) == (0.2, 3)


@pytest.mark.parametrize(
    ("options", "planned"),
    [
        (["--task", "spot_finding"], {Condition("spot_finding", "creative"): 2}),
        (["--proposer", "creative", "--robots", "4"], {
            Condition("spot_finding", "creative"): 4, Condition("wall_avoidance", "creative"): 4,
        }),
        (["--task", "spot_finding", "--proposer", "creative", "--robots", "1"], {
            Condition("spot_finding", "creative"): 1,
        }),
    ],
)  # fmt: skip
def test_options_choose_among_the_robots_of_a_file(
    options, planned, written, tmp_path, commands_in_process
):
    rows = "[{task: spot_finding, proposer: creative, robots: 2}, "
    rows += "{task: wall_avoidance, proposer: creative, robots: 3}]"
    path = written(f"experiment: {{time_scale: 0.0005, body: kinematic}}\nplan: {rows}\n")
    command = ["run", str(tmp_path / "run"), "--config", str(path), *options]
    assert cli.main(command) == 0
    assert read_manifest(tmp_path / "run").robots == planned


@pytest.mark.parametrize(
    "options",
    [
        ["--task", "spot_finding"],
        ["--task", "wall_avoidance", "spot_finding"],
        ["--proposer", "fixed", "creative"],
        ["--agent", "dqn"],
        ["--task", "wall_avoidance", "--proposer", "random"],
    ],
    ids=" ".join,
)
def test_robots_that_a_file_does_not_plan_are_refused(options, written, tmp_path, capsys):
    path = written("plan: [{task: wall_avoidance, proposer: fixed, robots: 2}]")
    assert cli.main(["run", str(tmp_path / "new"), "--config", str(path), *options]) == 2
    asked = ", ".join(options[1:]).replace("dqn", "musebot:dqn").replace("--proposer, ", "")
    assert capsys.readouterr().err == (
        f"musebot: {path} plans wall_avoidance/fixed: --task, --proposer and --agent choose among "
        f"these, got {asked}\n"
    )
    assert [*tmp_path.iterdir()] == [path]


def test_a_pair_that_a_file_does_not_plan_is_refused_though_it_plans_both_names(written, tmp_path):
    rows = "{task: wall_avoidance, proposer: fixed, robots: 2}, "
    rows += "{task: spot_finding, proposer: creative, robots: 2}"
    path = written(f"plan: [{rows}]")
    options = {"task": ("wall_avoidance",), "proposer": ("creative",)}
    command = RunCommand(tmp_path / "new", config=path, **options)
    with pytest.raises(InputError, match="plans wall_avoidance/fixed, spot_finding/creative: "):
        command._plan(None, read_config(path))


def test_an_agent_of_the_file_is_chosen_by_its_short_name(written, tmp_path):
    path = written(
        "plan: [{task: spot_finding, proposer: dqn, robots: 2}, "
        "{task: spot_finding, proposer: fixed, robots: 2}]"
    )
    command = RunCommand(tmp_path / "new", config=path, agent=("dqn",))
    plan = command._plan(None, read_config(path))
    assert plan.robots == {Condition("spot_finding", "musebot:dqn"): 2}


@pytest.mark.parametrize(
    "row", ["task: dancing, proposer: fixed", "task: spot_finding, proposer: x"]
)
def test_a_wrong_name_in_a_plan_is_reported_with_the_files_name(row, written, tmp_path, capsys):
    path = written(f"plan: [{{{row}, robots: 1}}]")
    assert cli.main(["run", str(tmp_path / "new"), "--config", str(path)]) == 2
    error = capsys.readouterr().err
    assert error.startswith(f"musebot: {path}: the") and error.count("\n") == 1


def test_a_file_that_is_not_there_is_one_sentence(tmp_path, capsys):
    assert cli.main(["run", str(tmp_path / "new"), "--config", str(tmp_path / "run.yaml")]) == 2
    assert capsys.readouterr().err == f"musebot: there is no file {tmp_path / 'run.yaml'}\n"


def test_without_a_reader_of_yaml_one_sentence_says_what_helps(written, monkeypatch):
    monkeypatch.setitem(__import__("sys").modules, "yaml", None)
    with pytest.raises(InputError, match="yaml is not installed; pip install"):
        read_config(written(EXAMPLE))
    assert read_config(written('{"experiment": {"seed": 3}}', "a.json")).fields == {"seed": 3}
