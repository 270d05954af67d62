"""The command: what it prints, and one sentence and exit status 2 for what cannot be done."""

import dataclasses
import json
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path
from typing import get_args

import pytest
from helpers import files_below

import musebot
from musebot.controller import BRAINS, INGREDIENTS, PROPOSERS
from musebot.models import Kinematics
from musebot.protocols.agents.names import RECORDED_NAMES
from musebot.protocols.cli import parser as cli
from musebot.protocols.cli import shared_options
from musebot.protocols.cli.run import RunCommand
from musebot.protocols.compare import STUDIES
from musebot.protocols.errors import InputError
from musebot.protocols.lives.conditions import PAPER_TASKS, Condition
from musebot.protocols.lives.config import Config
from musebot.protocols.lives.experiment import BODIES, Experiment, NosePlace, Physics
from musebot.protocols.lives.manifest import read_manifest
from musebot.protocols.lives.overrides import READINGS
from musebot.protocols.lives.plan import Plan
from musebot.protocols.lives.runs import simulate
from musebot.protocols.lives.schedules import PROTOCOLS
from musebot.tasks.sensors import NoseForm
from musebot.tasks.suite import TASKS


@pytest.fixture(scope="module")
def run(tmp_path_factory, in_process):
    directory = tmp_path_factory.mktemp("cli") / "run"
    conditions = (Condition("wall_avoidance", "fixed"), Condition("spot_finding", "creative"))
    plan = Plan.of(Experiment(cohort_size=2, time_scale=0.002), conditions, 2)
    simulate(directory, plan, in_process(), quiet=True)
    return directory


def test_tables_show_ours_next_to_the_papers_and_name_a_rehearsal(run, capsys):
    assert cli.main(["tables", str(run)]) == 0
    text = capsys.readouterr().out
    assert "Wall avoidance (table 1), all durations times 0.002" in text
    assert "fixed, ours" in text and "fixed, paper" in text and "260 (52%)" in text


def test_a_finished_run_prints_its_tables_again_and_keeps_them(run, capsys):
    assert cli.main(["run", str(run)]) == 0
    text = capsys.readouterr().out
    assert (run / "tables.md").read_text() == text
    assert cli.main(["tables", str(run)]) == 0
    assert capsys.readouterr().out == text


def test_two_runs_are_compared_cell_by_cell(run, capsys):
    assert cli.main(["tables", str(run), "--compare", f"{run}/../run/"]) == 0
    text = capsys.readouterr().out
    assert "Their experiments are the same" in text.splitlines()[0]
    assert "After Holm's correction 0 of 18 cells differ." in text
    assert cli.main(["tables", str(run), "--compare", str(run), "--json"]) == 0
    plain = json.loads(capsys.readouterr().out)
    assert plain["differ_in"] == {}
    assert len(plain["cells"]) == 18


def test_a_folder_without_a_run_cannot_be_compared(run, tmp_path, capsys):
    assert cli.main(["tables", str(run), "--compare", str(tmp_path)]) == 2
    assert f"{tmp_path} holds no experiment of musebot's" in capsys.readouterr().err


def test_tables_need_no_right_to_write(run, capsys, monkeypatch):
    monkeypatch.setattr(os, "access", lambda path, mode: False)
    assert cli.main(["tables", str(run)]) == 0
    assert "260 (52%)" in capsys.readouterr().out


def test_tables_as_json_hold_both(run, capsys):
    assert cli.main(["tables", str(run), "--json"]) == 0
    tables = json.loads(capsys.readouterr().out)["tables"]
    assert tables["spot_finding"]["creative"]["paper"]["counts"]["L = 1"] == 109
    ours = tables["spot_finding"]["creative"]["ours"]
    assert ours["robots"] == 2
    for name, count in ours["counts"].items():
        low, high = ours["intervals"]["shares"][name]
        assert 0 <= low <= count / 2 <= high <= 1
    assert ours["intervals"]["mean"] is None  # two robots are too few for an interval


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--task", "dancing"], "task must be one of wall_avoidance, spot_finding, got 'dancing'"),
        (["--proposer", "magic"], "the proposer must be one of fixed, random, creative, or"),
        (["--proposer", "fixed", "--proposer=random"], "--proposer is given twice"),
        (["--time-scale", "0.1", "--time_scale", "0.2"], "--time-scale is given twice"),
        (["--robots", "0"], "robots must be at least 1, got 0"),
        (["--robots", "-3"], "robots must be at least 1, got -3"),
        (["--robots", "5", "--cohort-size", "2"], "multiple of the cohort size, 2, got 5"),
        (["--cohort-size", "0"], "cohort size must be at least 1, got 0"),
        (["--processes", "0"], "processes must be at least 1, got 0"),
        (["--time-scale", "0"], "time scale must lie in (0, 1], got 0"),
        (["--time-scale", "nan"], "time scale must lie in (0, 1], got nan"),
        (["--seed", "-1"], "seed must not be negative, got -1"),
        (["--brain", "divine"], "brain must be one of paper, steady, steady-hidden_neurons, "),
        (["--nose", "red"], "nose must be one of inverse, printed, got 'red'"),
        (["--nose-place", "tail"], "nose place must be one of front, centre, got 'tail'"),
        (["--reading", "late"], "the reading must be one of body, plain, got 'late'"),
        (["--kinematics", "wall=slides"], "kinematics are parameters of the body 'kinematic' only"),
        (
            ["--body=kinematic", "--kinematics", "tyre=flat"],
            "one of radius, wheel_base, wall, felt",
        ),
        (["--body=kinematic", "--kinematics", "wall=soft"], "wall must be one of holds, slides,"),
        (["--body=kinematic", "--kinematics", "felt=warm"], "felt must be one of near, pushed"),
        (["--body=kinematic", "--kinematics", "lag=long"], "lag must be a number, got 'long'"),
        (
            ["--body=kinematic", "--kinematics", "radius"],
            "a parameter is set as NAME=VALUE, NAME one of",
        ),
        (["--body=kinematic", "--kinematics", "radius"], "got 'radius'"),
        (["--body=kinematic", "--kinematics", "radius=0.4"], "radius must be less than 0.1 m"),
        (["--body=kinematic", "--kinematics", "lag=0", "lag=1"], "lag is given twice"),
        (["--body=kinematic", "--kinematics", "any_contact=1"], "must be true or false, got 1"),
        (["--body=kinematic", "--kinematics", "pieces=1.5"], "must be a whole number"),
        (["--set", "soul=1"], "a parameter is set as NAME=VALUE, NAME one of evaluation_hidden, "),
        (["--set", "soul=1"], "got 'soul=1'"),
        (["--set", "ideas=2.5"], "ideas must be a whole number from 1 to 10000, got 2.5"),
        (
            ["--brain=steady", "--set", "centred_inputs=0"],
            "centred_inputs must be true or false, got 0",
        ),
        (["--set", "epsilon=true"], "epsilon must lie in [0, 1], got True"),
        (["--set", "fixed_motors=0.5"], "fixed_motors must be 1 to 100 numbers"),
        (
            ["--set", "initial_epsilon=None"],
            "initial_epsilon must lie in [0, 1] or be none",
        ),
        (["--set", "epsilon=2"], "epsilon must lie in [0, 1], got 2"),
        (["--save-every", "0"], "save-every must be positive, got 0"),
        (["--protocol", "night"], "protocol must be one of paper, continual, walls, got 'night'"),
        (
            ["--protocol", "continual", "--task", "wall_avoidance"],
            "the protocol continual has only spot_finding, got wall_avoidance",
        ),
        (["--agent", "hand"], "there is no agent 'hand': did you mean hand_coded?"),
        (
            ["--agent", "dqn", "--robots=100000", "--cohort-size=100000"],
            "dqn would need ",
        ),
    ],
)
def test_bad_input_to_run_is_one_sentence_and_nothing_is_made(arguments, words, tmp_path, capsys):
    assert cli.main(["run", str(tmp_path / "new"), *arguments]) == 2
    message = capsys.readouterr().err
    assert words in message
    assert message.count("\n") == 1
    assert list(tmp_path.iterdir()) == []


def test_a_prime_number_of_robots_may_be_one_cohort(tmp_path, capsys, commands_in_process):
    command = ["run", str(tmp_path / "prime"), "--robots", "251"]
    assert cli.main(command) == 2
    assert "or name a cohort size" in capsys.readouterr().err
    tiny = "--cohort-size 251 --time-scale 0.0001 --task spot_finding --proposer fixed".split()
    assert cli.main([*command, *tiny, "--body", "kinematic"]) == 0


def test_settings_of_an_agent_may_be_given_in_any_order(tmp_path, commands_in_process):
    file = tmp_path / "run.yaml"
    file.write_text("experiment: {time_scale: 0.001, settings: [rate=0.1, discount=0.8]}\n")
    tiny = ["--agent", "sarsa_lambda", "--robots", "1", "--task", "spot_finding"]
    command = ["run", str(tmp_path / "out"), *tiny]
    assert cli.main([*command, "--config", str(file)]) == 0
    assert cli.main([*command, "--agent-set", "discount=0.8", "rate=0.1"]) == 0
    assert cli.main([*command, "--agent-set", "discount=0.9", "rate=0.1"]) == 2


def test_a_reading_of_the_paper_is_recorded_and_options_differ_from_it(
    tmp_path, capsys, commands_in_process
):
    scale = "--robots 1 --time-scale 0.001 --task wall_avoidance --proposer fixed".split()
    plain = ["run", str(tmp_path / "plain"), "--reading", "plain"]
    assert cli.main([*plain, *scale]) == 0
    held = read_manifest(tmp_path / "plain").experiment
    assert {name: getattr(held, name) for name in READINGS["plain"]} == READINGS["plain"]
    assert held.kinematics == Kinematics(wall="refuses", felt="pushed", pieces=1, path="euler")
    assert cli.main(plain) == 0
    assert cli.main(plain[:2]) == 0
    assert cli.main([*plain[:2], "--reading", "body"]) == 2
    assert "an experiment with body kinematic, not mujoco" in capsys.readouterr().err
    other = ["run", str(tmp_path / "other"), "--reading", "plain", "--nose", "inverse"]
    assert cli.main([*other, "--kinematics", "lag=0.1", *scale]) == 0
    changed = read_manifest(tmp_path / "other").experiment
    assert (changed.nose, changed.nose_place) == ("inverse", "centre")
    assert changed.kinematics == dataclasses.replace(held.kinematics, lag=0.1)


def test_a_reading_in_another_body_leaves_out_the_kinematics_of_its_own(tmp_path):
    mujoco = RunCommand(tmp_path / "run", reading="plain", body="mujoco")
    found = mujoco._plan(None, Config()).experiment
    expected = {**READINGS["plain"], "body": "mujoco", "kinematics": Kinematics()}
    assert {name: getattr(found, name) for name in expected} == expected
    own = RunCommand(tmp_path / "run", reading="plain", body="kinematic")
    assert own._plan(None, Config()).experiment.kinematics == READINGS["plain"]["kinematics"]
    given = RunCommand(tmp_path / "run", reading="plain", body="mujoco", kinematics=("lag=0.1",))
    with pytest.raises(InputError, match="kinematics are parameters of the body 'kinematic' only"):
        given._plan(None, Config())


def test_the_default_reading_is_body():
    experiment = Experiment()
    assert {name: getattr(experiment, name) for name in READINGS["body"]} == READINGS["body"]
    assert experiment == Experiment(**READINGS["body"])


def test_tables_class_exact_abilities_when_asked(tmp_path, capsys):
    directory = tmp_path / "run"
    shutil.copytree(RESULTS / "kinematic", directory)
    counts = []
    for extra in ([], ["--exact-classes"]):
        assert cli.main(["tables", str(directory), "--json", *extra]) == 0
        plain = json.loads(capsys.readouterr().out)
        assert plain["exact_classes"] == bool(extra)
        counts.append([*plain["tables"]["wall_avoidance"]["fixed"]["ours"]["counts"].values()])
    assert counts == [[255, 11, 17, 22, 195], [248, 23, 2, 32, 195]]


def test_the_kinematic_simulator_has_the_given_parameters(tmp_path, capsys, commands_in_process):
    words = "--body kinematic --kinematics wall=slides felt=pushed lag=.08 any_contact=true"
    scale = "--robots 1 --time-scale 0.001 --task wall_avoidance --proposer fixed".split()
    assert cli.main(["run", str(tmp_path), *words.split(), *scale]) == 0
    kept = read_manifest(tmp_path).experiment.kinematics
    assert kept == Kinematics(wall="slides", felt="pushed", lag=0.08, any_contact=True)
    assert cli.main(["run", str(tmp_path), "--kinematics", "lag=0.08"]) == 0
    assert cli.main(["run", str(tmp_path), "--kinematics", "lag=0.1"]) == 2
    held = "holds an experiment with kinematics.lag 0.08, not 0.1"
    assert held in capsys.readouterr().err


def test_a_brain_is_the_named_one_with_its_overrides(tmp_path, capsys, commands_in_process):
    words = "--brain steady --set advantage_scale=0.4 fixed_motors=[0.0,0.5]".split()
    scale = "--robots 1 --time-scale 0.001 --task wall_avoidance --proposer fixed".split()
    for again in ([], words):
        assert cli.main(["run", str(tmp_path), *(again or words), *scale]) == 0
    own = read_manifest(tmp_path).experiment.brain
    assert own == dataclasses.replace(
        BRAINS["steady"], advantage_scale=0.4, fixed_motors=(0.0, 0.5)
    )
    assert "brain: steady fixed_motors=[0.0,0.5] advantage_scale=0.4" in capsys.readouterr().out
    assert cli.main(["run", str(tmp_path), "--set", "advantage_scale=0.3"]) == 2
    assert "holds an experiment with brain." in capsys.readouterr().err


def test_a_foreign_folder_is_refused_and_left_alone(tmp_path, capsys):
    (tmp_path / "thesis.tex").write_text("precious")
    assert cli.main(["run", str(tmp_path)]) == 2
    assert "is not empty and holds no experiment of musebot's" in capsys.readouterr().err
    assert files_below(tmp_path) == {Path("thesis.tex"): b"precious"}


def test_a_foreign_experiment_json_is_refused_and_left_alone(tmp_path, capsys):
    (tmp_path / "experiment.json").write_text('{"lab": "mine"}')
    assert cli.main(["run", str(tmp_path)]) == 2
    assert "is not an experiment of musebot's" in capsys.readouterr().err
    assert files_below(tmp_path) == {Path("experiment.json"): b'{"lab": "mine"}'}


def test_an_out_that_is_a_file_or_below_one_is_refused(tmp_path, capsys):
    (tmp_path / "file").write_text("x")
    for out in (tmp_path / "file", tmp_path / "file" / "below"):
        assert cli.main(["run", str(out)]) == 2
        assert "is not a folder" in capsys.readouterr().err


def test_an_unwritable_out_is_refused(tmp_path, capsys, monkeypatch):
    # Simulated: root, who runs the tests in a container, may write anything.
    monkeypatch.setattr(os, "access", lambda path, mode: False)
    assert cli.main(["run", str(tmp_path / "run")]) == 2
    assert f"{tmp_path} cannot be written" in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == []


def test_other_parameters_than_a_folders_own_are_refused_and_nothing_changes(run, capsys):
    before = files_below(run)
    others = (
        ("seed", "7", "1"),
        ("cohort-size", "1", "2"),
        ("nose", "printed", "inverse"),
        ("brain", "steady", "paper, not steady"),
    )
    for name, value, own in others:
        assert cli.main(["run", str(run), f"--{name}", value]) == 2
        assert f"with {name.replace('-', '_')} {own}" in capsys.readouterr().err
    assert files_below(run) == before


def test_a_run_of_another_brain_continues_with_it_and_names_it(
    tmp_path, capsys, commands_in_process
):
    out = str(tmp_path / "run")
    short = ["--robots", "2", "--time-scale", "0.001", "--body", "kinematic", "--processes", "1"]
    which = ["--task", "spot_finding", "--proposer", "creative"]
    assert cli.main(["run", out, *short, *which, "--brain", "steady"]) == 0
    title = "Spot finding (table 2), brain: steady, body: kinematic, all durations times 0.001"
    assert title in capsys.readouterr().out
    assert cli.main(["run", out, "--brain", "paper"]) == 2
    assert "holds an experiment with brain." in capsys.readouterr().err
    assert cli.main(["run", out, *which, "--robots", "4"]) == 0
    plan = read_manifest(tmp_path / "run")
    assert plan.experiment.brain == BRAINS["steady"]
    assert plan.robots == {Condition("spot_finding", "creative"): 4}
    capsys.readouterr()
    assert cli.main(["tables", out, "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["brain"] == "steady"


@pytest.mark.parametrize("asked", [["tables"], ["run", "--help"]], ids=" ".join)
def test_a_reader_that_closes_the_pipe_early_sees_no_complaint(run, asked):
    read, write = os.pipe()
    os.close(read)
    with open(write, "wb") as closed:
        done = subprocess.run(
            [sys.executable, "-m", "musebot", *asked, str(run)],
            stdout=closed, stderr=subprocess.PIPE, text=True, check=False,
        )  # fmt: skip
    assert (done.returncode, done.stderr) == (141, "")


def test_two_folders_of_one_name_are_named_by_their_paths(run, tmp_path, capsys):
    copy = tmp_path / run.name
    shutil.copytree(run, copy)
    assert cli.main(["tables", str(run), "--compare", str(copy)]) == 0
    names = [f"{folder.parent.name}/{folder.name}" for folder in (run, copy)]
    assert f"**{names[0]}** compared with **{names[1]}**" in capsys.readouterr().out


def test_tables_of_nothing_are_refused(tmp_path, capsys):
    assert cli.main(["tables", str(tmp_path)]) == 2
    assert "holds no experiment of musebot's" in capsys.readouterr().err


def test_a_wrong_mujoco_is_one_sentence_and_exit_status_2(tmp_path):
    code = (
        "import mujoco, sys; mujoco.__version__ = '4.0.0'; "
        "from musebot.protocols import cli; sys.exit(cli.main(sys.argv[1:]))"
    )
    run = subprocess.run(
        [sys.executable, "-c", code, "run", str(tmp_path / "new")],
        capture_output=True, text=True, check=False, env=os.environ | {"MUJOCO_GL": "off"},
    )  # fmt: skip
    assert run.returncode == 2
    assert "musebot needs MuJoCo 3.17.x" in run.stderr
    assert "Traceback" not in run.stderr
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("verb", cli.VERBS)
def test_every_verb_has_a_help_text(verb, capsys):
    assert cli.main([verb, "--help"]) == 0
    assert len(capsys.readouterr().out) > 100


def test_the_verbs_are_these():
    verbs = "demo run tables film report figure study explore check-agent list bench doctor"
    assert " ".join(cli.VERBS) == verbs


def test_no_word_shows_the_help_and_version_the_version(capsys):
    assert cli.main([]) == 0
    text = capsys.readouterr().out
    assert "usage: musebot" in text and all(f" {verb} " in text for verb in cli.VERBS)
    assert cli.main(["--version"]) == 0
    assert capsys.readouterr().out == f"musebot {musebot.__version__}\n"


def test_an_unknown_verb_is_refused_with_all_verbs(capsys):
    assert cli.main(["dance"]) == 2
    sentence = f"musebot: there is no verb 'dance'; there are {', '.join(cli.VERBS)}\n"
    assert capsys.readouterr().err == sentence
    assert cli.main(["tabels", "runs"]) == 2
    assert capsys.readouterr().err == "musebot: there is no verb 'tabels'; did you mean tables?\n"
    assert cli.main(["leaderboard", "runs"]) == 2
    err = capsys.readouterr().err
    assert err == "musebot: leaderboard is a study: musebot study leaderboard OUT\n"


def test_everything_with_a_name_is_listed_with_a_line(capsys):
    assert cli.main(["list"]) == 0
    kinds = re.split(r"^(\w+):\n", capsys.readouterr().out, flags=re.M)[1:]
    lists = dict(zip(kinds[::2], kinds[1::2], strict=True))
    names = {
        "tasks": TASKS, "brains": BRAINS, "protocols": PROTOCOLS, "studies": STUDIES,
        "agents": (*PROPOSERS, *RECORDED_NAMES),
    }  # fmt: skip
    assert [*lists] == [*names]
    for kind, text in lists.items():
        lines = [line.split(maxsplit=1) for line in text.splitlines()]
        assert [name for name, _ in lines] == [*names[kind]]
        assert all(line.endswith(".") for _, line in lines)
    assert cli.main(["list", "protocols"]) == 0
    assert "  " + capsys.readouterr().out.splitlines()[0] in lists["protocols"]


def test_an_unknown_list_is_refused(capsys):
    assert cli.main(["list", "feelings"]) == 2
    assert (
        "list must be one of tasks, brains, protocols, studies, agents" in capsys.readouterr().err
    )


@pytest.mark.parametrize("shell", ["bash", "zsh"])
def test_completion_is_that_of_the_command(shell, capsys):
    assert cli.main(["--tyro-print-completion", shell]) == 0
    text = capsys.readouterr().out
    assert "musebot" in text and "--cohort-size" in text


def test_help_loads_neither_torch_nor_mujoco():
    code = (
        "import sys\n"
        "from musebot.protocols import cli\n"
        "assert cli.main(['run', '--help']) == 0\n"
        "assert cli.main(['study']) == 0\n"
        "assert not {'torch', 'mujoco', 'dm_control', 'matplotlib'} & set(sys.modules)\n"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr


@pytest.mark.parametrize(
    ("words", "sentence"),
    [
        (["run", "new", "--task"], "--task needs a value"),
        (["run", "new", "--set", "--seed", "1"], "--set needs a value"),
        (["run", "new", "--agent_set"], "--agent-set needs a value"),
        (["film", "--output", "x.mp4", "--task"], "--task needs a value"),
        (["study", "ablation", "new", "--robots"], "--robots needs a value"),
        (["run", "new", "--seed", "abc"], "--seed must be a whole number, got 'abc'"),
        (["run", "--seed=1.5", "new"], "--seed must be a whole number, got '1.5'"),
        (["run", "new", "--seed", "None"], "--seed must have a value, got None"),
        (["run", "new", "--reading", "None"], "--reading must have a value, got None"),
        (["run", "new", "--time-scale", "1,5"], "--time-scale must be a number, got '1,5'"),
        (["run", "new", "--processes", "all"], "--processes must be a whole number, got 'all'"),
        (["study", "ablation", "new", "--robots", "x"], "--robots must be a whole number, got 'x'"),
        (["demo", "new", "--time-scale", "fast"], "--time-scale must be a number, got 'fast'"),
        (["run"], "OUT is missing: musebot run OUT"),
        (["run", "--robots", "4"], "OUT is missing: musebot run OUT"),
        (["film", "--task=x"], "--output is missing: musebot film --task TASK --output FILE"),
        (["figure", "robot"], "FILE is missing: musebot figure NAME FILE"),
        (["check-agent"], "AGENT is missing: musebot check-agent AGENT"),
        (["film", "--robt", "1"],
         "there is no option --robt; did you mean --robot?"),
        (["study", "--all"], "there is no option --all; there are none"),
        (["run", "new", "old"], "'old' is one word too many"),
        (["run", "new", "--seed", "1", "old"], "'old' is one word too many"),
        (["run", "new", "--trust-agent", "yes"], "'yes' is one word too many"),
        (["tables", "-json", "new"], "there is no option -json; did you mean --json?"),
        (["run", "new", "--trust-agent=false"], "--trust-agent takes no value, got 'false'"),
        (["run", "--task", "new"], "--task needs a value, or OUT is missing"),
        (["study", "benchmark", "--board", "a"], "--board needs a value, or OUT is missing"),
        (["run", "--task", "x", "new", "--"], "OUT is missing: musebot run OUT"),
        (["film", "new", "--output", "-f.mp4"], "there is no option -f.mp4; a value that begins "
         "with a dash stands behind =, as in --output=-f.mp4"),
        (["run", "--task", "x", "new", "--seed", "1"],
         "OUT is missing: musebot run OUT (all words after --task are its values)"),
        (["run", "new", "--log", "all"], "--log must be one of none, tensorboard, got 'all'"),
        (["run", "new", "--engine", "steam"], "--engine must be one of local, ray, got 'steam'"),
        (["run", "new", "--set-of", "epsilon=1"],
         "there is no option --set-of; did you mean --set?"),
        (["figure", "dog", "x.svg"], "NAME must be one of architecture, robot, typical, got 'dog'"),
        (["study", "benchmark", "a", "--signals", "raw", "b"],
         "--signals must be one of paper, raw, got 'b'"),
    ],
)  # fmt: skip
def test_words_that_a_command_does_not_take_are_one_sentence(
    words, sentence, tmp_path, monkeypatch, capsys
):
    monkeypatch.chdir(tmp_path)
    assert cli.main(words) == 2
    assert capsys.readouterr().err == f"musebot: {sentence}\n"
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    "words",
    [
        ["new", "--task", "wall_avoidance"],
        ["--task", "wall_avoidance", "new"],
        ["--task", "wall_avoidance", "--", "new"],
        ["--seed", "1", "new", "--task=wall_avoidance"],
    ],
    ids=" ".join,
)
def test_a_folder_may_stand_before_or_after_the_options(words):
    command = cli.parsed(RunCommand, "musebot run", words)
    assert (str(command.out), command.task) == ("new", ("wall_avoidance",))


def test_all_words_after_two_dashes_are_no_options():
    assert str(cli.parsed(RunCommand, "musebot run", ["--", "-out"]).out) == "-out"
    assert str(cli.parsed(RunCommand, "musebot run", ["--", "--seed"]).out) == "--seed"


@pytest.mark.parametrize(
    "words",
    [
        ["run", "", "--seed", "1"],
        ["run", "--seed", "1", ""],
        ["run", "new", "--config="],
        ["demo", ""],
        ["report", ""],
        ["study", "ablation", ""],
        ["explore", "--out", ""],
    ],
    ids=" ".join,
)
def test_an_empty_word_is_refused_by_all_verbs(words, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert cli.main(words) == 2
    sentence = "musebot: a word of the command is empty: is a variable of the shell unset?\n"
    assert capsys.readouterr().err == sentence
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("words", "sentence"),
    [
        (
            ["run", "new", "--address", "1.2.3.4:5"],
            "--address is for the engine ray",
        ),
        (
            ["study", "timestep", "new", "--engine", "ray", "--processes", "1"],
            "--processes is for the engine local",
        ),
        (["explore", "--keys", "--robot", "7"], "--robot chooses a brain or a policy"),
        (["explore", "--random", "--robot", "0"], "--robot chooses a brain or a policy"),
        (["explore", "--random", "--phase", "pre"], "--phase chooses a brain or a policy"),
    ],
)
def test_an_option_that_another_one_makes_useless_is_refused(
    words, sentence, tmp_path, monkeypatch, capsys
):
    monkeypatch.chdir(tmp_path)
    assert cli.main(words) == 2
    error = capsys.readouterr().err
    assert error.startswith(f"musebot: {sentence}") and error.count("\n") == 1
    assert list(tmp_path.iterdir()) == []


COMMANDS = [[verb] for verb in cli.VERBS] + [["study", name] for name in STUDIES]


@pytest.mark.parametrize("command", COMMANDS, ids=" ".join)
def test_the_usage_has_each_required_word_and_no_line_of_help_is_broken(
    command, capsys, monkeypatch
):
    monkeypatch.setenv("COLUMNS", "2000")
    assert cli.main([*command, "--help"]) == 0
    usage, *lines = capsys.readouterr().out.splitlines()
    lines = [line.replace("│", " ").rstrip() for line in lines]  # without the frame of a terminal
    rows = [line.strip() for line in lines if line.startswith("  ")]
    for row, before in zip(rows, ["", *rows], strict=False):
        if row.endswith("(required)"):  # the name may stand in a line of its own
            name = (row if "  " in row else before).split()[0]
            assert usage.split().count(name) == 1
        alone = row.startswith("-") and "  " not in row
        whole = row.endswith((")", "exit")) or row.startswith("[KIND]")
        assert alone or whole, row
    assert rows


def test_the_studies_are_named_by_the_help_that_lists_them(capsys):
    assert cli.main(["study", "--help"]) == 0
    text = capsys.readouterr().out
    assert ", ".join(STUDIES) in " ".join(text.split())


def test_help_is_shown_where_an_option_has_no_value_yet(capsys):
    assert cli.main(["run", "new", "--task", "--help"]) == 0
    text = capsys.readouterr().out
    assert "--cohort-size" in text and text.startswith("usage: musebot run [-h] [OPTIONS] OUT\n")


def choices(text):
    """Returns the values that help shows as "{a,b,c}"."""
    return tuple(text.strip("{}").split(","))


def test_the_values_that_help_shows_are_those_of_the_code():
    assert choices(shared_options.TASK_CHOICES) == PAPER_TASKS
    assert choices(shared_options.PROPOSER_CHOICES) == tuple(PROPOSERS)
    assert choices(shared_options.BODY_CHOICES) == BODIES


def test_help_names_every_value_that_a_choice_has(capsys, monkeypatch):
    monkeypatch.setenv("COLUMNS", "200")
    assert cli.main(["run", "--help"]) == 0
    named = dict(re.findall(r"--([\w-]+) \{(.*?)\}", capsys.readouterr().out))
    *whole, less = named.pop("brain").split(",")
    ours = {f"steady-{ingredient}" for ingredient in INGREDIENTS}
    assert {*whole} == BRAINS.keys() - ours and less == "steady-X"
    assert {name: tuple(values.split(",")) for name, values in named.items()} == {
        "device": ("cpu", "cuda", "cuda:N"),
        "signals": ("paper", "raw"),
        "task": PAPER_TASKS,
        "proposer": tuple(PROPOSERS),
        "protocol": tuple(PROTOCOLS),
        "motor-torque": ("constant", "scaled"),
        "reading": tuple(READINGS),
        "nose": get_args(NoseForm),
        "nose-place": get_args(NosePlace),
        "body": BODIES,
        "physics": get_args(Physics),
        "engine": ("local", "ray"),
        "log": ("none", "tensorboard"),
    }


SHORT = "--robots 2 --time-scale 0.001 --body kinematic".split()


@pytest.mark.parametrize("protocol", ["walls"])
def test_a_run_keeps_its_protocol_and_has_spot_finding_only(
    protocol, tmp_path, capsys, commands_in_process
):
    out = str(tmp_path)
    command = ["run", out, *SHORT, "--proposer", "creative", "--protocol", protocol]
    assert cli.main(command) == 0
    assert f"protocol: {protocol}" in capsys.readouterr().out
    plan = read_manifest(tmp_path)
    assert plan.experiment.protocol == protocol
    assert plan.robots == {Condition("spot_finding", "creative"): 2}
    assert cli.main(["run", out]) == 0
    assert cli.main(["run", out, "--protocol", "paper"]) == 2
    sentence = f"holds an experiment with protocol {protocol}, not paper"
    assert sentence in capsys.readouterr().err


def test_options_that_are_not_given_keep_the_stored_values(tmp_path, commands_in_process):
    out = str(tmp_path)
    which = ["--task", "wall_avoidance", "--proposer", "fixed", "--seed", "5"]
    assert cli.main(["run", out, *SHORT, *which]) == 0
    before = read_manifest(tmp_path)
    assert cli.main(["run", out]) == 0
    assert read_manifest(tmp_path) == before
    assert cli.main(["run", out, "--robots", "4"]) == 0
    assert read_manifest(tmp_path) == dataclasses.replace(
        before, robots={Condition("wall_avoidance", "fixed"): 4}
    )
    assert cli.main(["run", out, "--proposer", "random", "--task", "spot_finding"]) == 0
    assert read_manifest(tmp_path).robots == {
        Condition("wall_avoidance", "fixed"): 4,
        Condition("spot_finding", "random"): 4,
    }


def test_tables_of_runs_of_two_protocols_are_not_compared(tmp_path, capsys, commands_in_process):
    for protocol in ("paper", "walls"):
        command = ["run", str(tmp_path / protocol), *SHORT, "--task", "spot_finding"]
        assert cli.main([*command, "--proposer", "fixed", "--protocol", protocol]) == 0
    capsys.readouterr()
    words = ["tables", str(tmp_path / "paper"), "--compare", str(tmp_path / "walls")]
    assert cli.main(words) == 2
    assert "protocols" in capsys.readouterr().err
