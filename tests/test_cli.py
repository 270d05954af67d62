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

from musebot.controller import BRAINS, INGREDIENTS, PROPOSERS
from musebot.models import Kinematics
from musebot.protocols import cli
from musebot.protocols.experiment.experiment import BODIES, TASKS, Experiment, Plan, load_plan
from musebot.protocols.experiment.schedules import COURSES
from musebot.protocols.simulation import engine
from musebot.protocols.simulation.local import Processes
from musebot.protocols.studies import ablation, creativity, robustness, sensitivity
from musebot.protocols.studies import continual as day
from musebot.tasks.sensors import NoseForm


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    directory = tmp_path_factory.mktemp("cli") / "run"
    conditions = (("wall_avoidance", "fixed"), ("spot_finding", "creative"))
    plan = Plan.of(Experiment(cohort_size=2, time_scale=0.002), conditions, 2)
    engine.run(directory, plan, Processes(2), quiet=True)
    return directory


def listing(directory):
    return {
        str(path.relative_to(directory)): path.read_bytes()
        for path in Path(directory).rglob("*")
        if path.is_file()
    }


def test_tables_show_ours_beside_the_papers_and_say_it_was_a_rehearsal(run, capsys):
    assert cli.main(["tables", str(run)]) == 0
    text = capsys.readouterr().out
    assert "Wall avoidance (table 1), a rehearsal: every duration times 0.002" in text
    assert "fixed, ours" in text and "fixed, paper" in text and "260 (52%)" in text


def test_a_finished_run_prints_its_tables_again_and_keeps_them(run, capsys):
    assert cli.main(["run", str(run)]) == 0
    text = capsys.readouterr().out
    assert (run / "tables.md").read_text() == text
    assert cli.main(["tables", str(run)]) == 0
    assert capsys.readouterr().out == text


RESULTS = Path(__file__).parents[1] / "docs" / "results"


def made_again(page, capsys):
    """What the lives beside a page give, by the command that docs/results.md names."""
    if page.name == "sensitivity.md":
        return sensitivity.report(page.parent)
    if page.name == "ablation.md":
        return ablation.report(page.parent)
    if page.name == "robustness.md":
        return robustness.report(page.parent)
    contests = {"creativity.md": creativity, "day.md": day}
    if page.name in contests:  # they name their runs, in their order
        names = re.findall(r"(?m)^- (\S+): ", page.read_text())
        contests[page.name].main(tuple(map(RESULTS.joinpath, names)))
        return capsys.readouterr().out
    arguments = [str(page.parent)]
    if page.name.startswith("beside-"):
        arguments += ["--beside", str(page.parent.with_name(page.stem.removeprefix("beside-")))]
    else:
        assert page.name == "tables.md"
    assert cli.main(["tables", *arguments]) == 0
    return capsys.readouterr().out


@pytest.mark.parametrize(
    "page",
    [
        # A study compares a thousand cells, which takes minutes.
        pytest.param(page, marks=pytest.mark.night if page.name == "sensitivity.md" else ())
        for page in sorted(RESULTS.rglob("*.md"))
    ],
    ids=lambda page: str(page.relative_to(RESULTS)),
)
def test_every_page_of_results_in_docs_is_what_its_lives_give_again(page, capsys):
    assert made_again(page, capsys) == page.read_text()


def test_the_example_of_the_page_on_results_reads_a_run(capfd):
    (example,) = re.findall(r"```python\n(.*?)```", (RESULTS / "../results.md").read_text(), re.S)
    command = [sys.executable, "-c", example]
    subprocess.run(command, cwd=RESULTS.parents[1], check=True)
    row, curves, weights, motors = capfd.readouterr().out.splitlines()
    assert row.startswith("Robot(task='wall_avoidance', proposer='fixed', seed=1")
    assert (curves, weights) == ("(500, 360)", "(500, 7, 3)")
    assert all(abs(float(motor)) <= 0.5 for motor in motors.strip("[]").split())


def test_every_run_in_docs_has_its_tables_or_is_part_of_a_study():
    folders = [path.parent for path in RESULTS.rglob("robots.csv")]
    assert folders
    for folder in folders:
        series = folder.parent / "sensitivity.md", folder.parent / "ablation.md"
        assert (folder / "tables.md").exists() or any(page.exists() for page in series)


def test_two_runs_stand_side_by_side(run, capsys):
    assert cli.main(["tables", str(run), "--beside", f"{run}/../run/"]) == 0
    text = capsys.readouterr().out
    assert "Their experiments are the same" in text.splitlines()[0]
    assert "After Holm's correction 0 of 18 cells differ." in text
    assert cli.main(["tables", str(run), "--beside", str(run), "--json"]) == 0
    plain = json.loads(capsys.readouterr().out)
    assert plain["differ_in"] == {}
    assert len(plain["cells"]) == 18


def test_what_tables_cannot_stand_beside_is_refused(run, tmp_path, capsys):
    assert cli.main(["tables", str(run), "--beside", str(tmp_path)]) == 2
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
    assert ours["intervals"]["mean"] is None  # two robots tell nothing of others


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--task", "dancing"], "task must be one of wall_avoidance, spot_finding, got 'dancing'"),
        (["--proposer", "magic"], "proposer must be one of fixed, random, creative, or an agent's"),
        (["--proposer", "fixed", "--proposer=random"], "--proposer is given twice"),
        (["--robots", "0"], "number of robots must be at least 1, got 0"),
        (["--robots", "-3"], "number of robots must be at least 1, got -3"),
        (["--robots", "5", "--cohort-size", "2"], "multiple of the cohort size, 2, got 5"),
        (["--cohort-size", "0"], "cohort size must be at least 1, got 0"),
        (["--processes", "0"], "number of processes must be at least 1, got 0"),
        (["--time-scale", "0"], "time scale must lie in (0, 1], got 0"),
        (["--time-scale", "nan"], "time scale must lie in (0, 1], got nan"),
        (["--seed", "-1"], "seed must not be negative, got -1"),
        (["--brain", "divine"], "brain must be one of paper, steady, steady-neurons, "),
        (["--nose", "red"], "nose must be 'inverse' or 'printed', got 'red'"),
        (["--kinematics", "wall=slides"], "only the kinematic body is told how it drives"),
        (
            ["--body=kinematic", "--kinematics", "tyre=flat"],
            "one of radius, wheel_base, wall, felt",
        ),
        (["--body=kinematic", "--kinematics", "wall=soft"], "wall must be one of holds, slides,"),
        (["--body=kinematic", "--kinematics", "felt=warm"], "felt must be one of near, pushed"),
        (["--body=kinematic", "--kinematics", "lag=long"], "lag must be a number, got 'long'"),
        (["--body=kinematic", "--kinematics", "radius"], "can be told as NAME=VALUE, got 'radius'"),
        (["--body=kinematic", "--kinematics", "radius=0.4"], "radius must be less than 0.1 m"),
        (["--body=kinematic", "--kinematics", "lag=0", "lag=1"], "lag is told twice"),
        (["--body=kinematic", "--kinematics", "any_contact=1"], "must be true or false, got 1"),
        (["--body=kinematic", "--kinematics", "pieces=1.5"], "must be a whole number"),
        (["--but", "soul=1"], "can be told as NAME=VALUE, got 'soul=1'"),
        (["--but", "ideas=2.5"], "ideas must be a whole number, got 2.5"),
        (["--brain=steady", "--but", "centred=0"], "centred must be true or false, got 0"),
        (["--but", "epsilon=true"], "epsilon must be a number, got True"),
        (["--but", "fixed_motors=0.5"], "fixed_motors must be several numbers, got 0.5"),
        (["--but", "young_epsilon=None"], "young_epsilon must be a number or none, got 'None'"),
        (["--but", "epsilon=2"], "epsilon must lie in [0, 1], got 2"),
        (["--save-every", "0"], "save-every must be positive, got 0"),
        (["--engine", "steam"], "engine must be local or ray, got 'steam'"),
    ],
)
def test_bad_input_to_run_is_one_sentence_and_nothing_is_made(arguments, words, tmp_path, capsys):
    assert cli.main(["run", str(tmp_path / "new"), *arguments]) == 2
    message = capsys.readouterr().err
    assert words in message
    assert message.count("\n") == 1
    assert list(tmp_path.iterdir()) == []


def test_the_stand_in_drives_as_it_is_told(tmp_path, capsys):
    words = "--body kinematic --kinematics wall=slides felt=pushed lag=.08 any_contact=true"
    scale = "--robots 1 --time-scale 0.001 --task wall_avoidance --proposer fixed".split()
    assert cli.main(["run", str(tmp_path), *words.split(), *scale]) == 0
    told = load_plan(tmp_path / "experiment.json").experiment.kinematics
    assert told == Kinematics(wall="slides", felt="pushed", lag=0.08, any_contact=True)
    assert cli.main(["run", str(tmp_path), "--kinematics", "lag=0.08"]) == 0
    assert cli.main(["run", str(tmp_path), "--kinematics", "lag=0.1"]) == 2
    held = "holds an experiment with kinematics wall=slides felt=pushed any_contact=true lag=0.08"
    assert f"{held}, not lag=0.1" in capsys.readouterr().err


def test_a_brain_is_the_named_one_but_for_what_is_told(tmp_path, capsys):
    words = "--brain steady --but action_gap=0.4 fixed_motors=[0.0,0.5]".split()
    scale = "--robots 1 --time-scale 0.001 --task wall_avoidance --proposer fixed".split()
    for again in ([], words):
        assert cli.main(["run", str(tmp_path), *(again or words), *scale]) == 0
    own = load_plan(tmp_path / "experiment.json").experiment.brain
    assert own == dataclasses.replace(BRAINS["steady"], action_gap=0.4, fixed_motors=(0.0, 0.5))
    assert "brain: steady fixed_motors=[0.0,0.5] action_gap=0.4" in capsys.readouterr().out
    assert cli.main(["run", str(tmp_path), "--but", "action_gap=0.3"]) == 2
    assert "holds an experiment with brain steady" in capsys.readouterr().err


def test_a_foreign_folder_is_refused_and_left_alone(tmp_path, capsys):
    (tmp_path / "thesis.tex").write_text("precious")
    assert cli.main(["run", str(tmp_path)]) == 2
    assert "is not empty and holds no experiment of musebot's" in capsys.readouterr().err
    assert listing(tmp_path) == {"thesis.tex": b"precious"}


def test_a_foreign_experiment_json_is_refused_and_left_alone(tmp_path, capsys):
    (tmp_path / "experiment.json").write_text('{"lab": "mine"}')
    assert cli.main(["run", str(tmp_path)]) == 2
    assert "is not an experiment of musebot's" in capsys.readouterr().err
    assert listing(tmp_path) == {"experiment.json": b'{"lab": "mine"}'}


def test_an_out_that_is_a_file_or_below_one_is_refused(tmp_path, capsys):
    (tmp_path / "file").write_text("x")
    for out in (tmp_path / "file", tmp_path / "file" / "below"):
        assert cli.main(["run", str(out)]) == 2
        assert "is not a folder" in capsys.readouterr().err


def test_an_unwritable_out_is_refused(tmp_path, capsys, monkeypatch):
    # Told by the system, not tried: root, who runs the tests in a container, may write anything.
    monkeypatch.setattr(os, "access", lambda path, mode: False)
    assert cli.main(["run", str(tmp_path / "run")]) == 2
    assert f"{tmp_path} cannot be written" in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == []


def test_other_parameters_than_a_folders_own_are_refused_and_nothing_changes(run, capsys):
    before = listing(run)
    others = (
        ("seed", "7", "1"),
        ("cohort-size", "1", "2"),
        ("nose", "printed", "inverse"),
        ("brain", "steady", "paper, not steady"),
    )
    for name, value, own in others:
        assert cli.main(["run", str(run), f"--{name}", value]) == 2
        assert f"with {name.replace('-', '_')} {own}" in capsys.readouterr().err
    assert listing(run) == before


def test_a_run_of_another_brain_goes_on_with_it_and_says_so(tmp_path, capsys):
    out = str(tmp_path / "run")
    short = ["--robots", "2", "--time-scale", "0.001", "--body", "kinematic", "--processes", "1"]
    which = ["--task", "spot_finding", "--proposer", "creative"]
    assert cli.main(["run", out, *short, *which, "--brain", "steady"]) == 0
    title = "Spot finding (table 2), brain: steady, body: kinematic, a rehearsal"
    assert title in capsys.readouterr().out
    assert cli.main(["run", out, "--brain", "paper"]) == 2
    assert "holds an experiment with brain steady, not paper" in capsys.readouterr().err
    assert cli.main(["run", out, *which, "--robots", "4"]) == 0
    plan = load_plan(tmp_path / "run" / "experiment.json")
    assert plan.experiment.brain == BRAINS["steady"]
    assert plan.robots == {("spot_finding", "creative"): 4}
    capsys.readouterr()
    assert cli.main(["tables", out, "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["brain"] == "steady"


@pytest.mark.parametrize("asked", [["tables"], ["run", "--help"]], ids=" ".join)
def test_who_reads_no_further_is_not_complained_to(run, asked):
    read, write = os.pipe()
    os.close(read)
    with open(write, "wb") as closed:
        done = subprocess.run(
            [sys.executable, "-m", "musebot", *asked, str(run)],
            stdout=closed, stderr=subprocess.PIPE, text=True, check=False,
        )  # fmt: skip
    assert (done.returncode, done.stderr) == (141, "")


def test_two_folders_of_one_name_are_told_apart(run, tmp_path, capsys):
    copy = tmp_path / run.name
    shutil.copytree(run, copy)
    assert cli.main(["tables", str(run), "--beside", str(copy)]) == 0
    assert f"**{run}** beside **{copy}**" in capsys.readouterr().out


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


@pytest.mark.parametrize("verb", ["run", "tables", "film", "report", "explore", "bench", "doctor"])
def test_every_verb_explains_itself(verb, capsys):
    with pytest.raises(SystemExit) as stop:
        cli.main([verb, "--help"])
    assert stop.value.code == 0
    assert len(capsys.readouterr().out) > 100


def test_help_names_every_value_that_a_choice_has(capsys, monkeypatch):
    monkeypatch.setenv("COLUMNS", "200")
    with pytest.raises(SystemExit):
        cli.main(["run", "--help"])
    named = dict(re.findall(r"--(\w+) \{(.*?)\}", capsys.readouterr().out))
    *whole, less = named.pop("brain").split(",")
    ours = {f"steady-{ingredient}" for ingredient in INGREDIENTS}
    assert {*whole} == BRAINS.keys() - ours and less == "steady-X"
    assert {name: tuple(values.split(",")) for name, values in named.items()} == {
        "task": TASKS,
        "proposer": tuple(PROPOSERS),
        "course": tuple(COURSES),
        "nose": get_args(NoseForm),
        "body": BODIES,
        "engine": ("local", "ray"),
    }


def test_importing_musebot_is_light_and_writes_nothing(tmp_path):
    code = (
        "import sys, os; before = dict(os.environ); import musebot; "
        "assert not {'torch', 'OpenGL', 'mujoco', 'dm_control'} & set(sys.modules); "
        "assert dict(os.environ) == before; print(musebot.__version__)"
    )
    run = subprocess.run(
        [sys.executable, "-c", code], cwd=tmp_path, capture_output=True, text=True, check=True
    )
    assert run.stdout.strip()
    assert list(tmp_path.iterdir()) == []
