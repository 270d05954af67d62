"""`musebot run`: what its words, a file and a folder plan, and what is refused."""

import dataclasses
import json
import sys
from pathlib import Path

import numpy as np
import pytest
from helpers import files_below

import musebot
from musebot.controller import BRAINS
from musebot.models import Kinematics
from musebot.protocols.cli import options
from musebot.protocols.cli import parser as cli
from musebot.protocols.cli import run as module
from musebot.protocols.cli.run import Run
from musebot.protocols.errors import InputError
from musebot.protocols.machine import cores
from musebot.protocols.runs.conditions import Condition
from musebot.protocols.runs.config import READINGS, Config, read_config, read_life
from musebot.protocols.runs.experiment import Experiment
from musebot.protocols.runs.manifest import MANIFEST, read_manifest
from musebot.protocols.runs.plan import Plan
from musebot.tasks.lives import Life, Phase

SHORT = {"time_scale": 0.001, "body": "kinematic", "quiet": True}
SF = Condition("spot_finding", "creative")
WA = Condition("wall_avoidance", "fixed")


def planned(held=None, file=None, **options):
    """Returns the plan of a command without its folder."""
    return Run(Path("out"), **options)._plan(file or Config(), held)


# What is planned

CHANGED = {
    "nose": "printed", "nose_place": "centre", "learn_across_placement": True,
    "motor_speed": 0.1, "motor_torque": "scaled",
    "physics": "warp", "cohort_size": 2, "seed": 7, "time_scale": 0.5, "body": "kinematic",
}  # fmt: skip


def test_every_field_of_an_experiment_is_set_by_a_word():
    for name, value in CHANGED.items():
        word = f"{name}={value if isinstance(value, str) else json.dumps(value)}"
        needed = ("motor_speed=0.1",) if name == "motor_torque" else ()
        assert getattr(planned(robots=2, set=(word, *needed)).experiment, name) == value


def test_parts_have_dotted_names_and_parts_that_are_not_set_stay():
    words = ("brain.epsilon=0.1", "brain.fixed_motors=[0.0,0.5]", "kinematics.lag=.08")
    found = planned(brain="steady", body="kinematic", set=words).experiment
    wanted = dataclasses.replace(BRAINS["steady"], epsilon=0.1, fixed_motors=(0.0, 0.5))
    assert found.brain == wanted
    assert found.kinematics == Kinematics(lag=0.08)


def test_a_reading_sets_its_fields_and_other_words_come_first():
    plain = planned(reading="plain").experiment
    assert {name: getattr(plain, name) for name in READINGS["plain"]} == READINGS["plain"]
    other = planned(reading="plain", set=("nose=printed", "kinematics.lag=0.1")).experiment
    assert (other.nose, other.nose_place) == ("printed", "centre")
    assert other.kinematics == dataclasses.replace(plain.kinematics, lag=0.1)
    # In another body the reading's kinematics, those of its own body, have no meaning.
    for other in ({"body": "mujoco"}, {"set": ("body=mujoco",)}):
        assert planned(reading="plain", **other).experiment.kinematics == Kinematics()
    assert planned().experiment == planned(reading="body").experiment


@pytest.mark.parametrize(
    ("options", "robots"),
    [
        ({}, {WA: 4, SF: 6}),
        ({"robots": 2}, {WA: 2, SF: 2}),
        ({"life": ("spot_finding",)}, {SF: 6}),
        ({"proposer": ("fixed",)}, {WA: 4}),
    ],
)
def test_what_is_not_given_is_that_of_the_folder_or_of_the_file(options, robots):
    known = {WA: 4, SF: 6}
    file = Config(robots=known)
    held = Plan(Experiment(cohort_size=2), known)
    assert planned(held, **options).robots == planned(file=file, **options).robots == robots
    dqn = {"agent": ("dqn",), "life": ("spot_finding",)}
    assert planned(held, **dqn).robots == {Condition(SF.life, "musebot:dqn"): 6}
    with pytest.raises(InputError, match="choose among these, got spot_finding/musebot"):
        planned(file=file, **dqn)


def test_settings_in_a_file_of_brains_and_agents_hold_whatever_the_command_chooses():
    dqn = Condition(SF.life, "musebot:dqn")
    file = Config({"settings": ("rate=0.1",)}, {SF: 2, dqn: 2})
    assert planned(file=file, proposer=("creative",)).robots == {SF: 2}
    assert planned(file=file, agent=("dqn",)).experiment.settings == ("rate=0.1",)


def test_settings_that_the_command_does_not_give_are_those_of_the_file_or_of_the_folder():
    rows, settings = {Condition(SF.life, "musebot:dqn"): 2}, ("hidden=32", "rate=0.1")
    held = Plan(Experiment(cohort_size=2, settings=settings), rows)
    file = Config({"settings": [*settings]}, rows)
    assert planned(held, set=("agent.rate=0.1",)).experiment == held.experiment
    assert planned(file=file, set=("agent.rate=1",)).experiment.settings == ("hidden=32", "rate=1")
    with pytest.raises(InputError, match="settings must be words NAME=VALUE, got 5"):
        planned(file=Config({"settings": 5}, rows))
    assert planned(file=Config({"settings": 5}, rows), set=("agent.rate=1",))


def test_a_life_of_ones_own_in_a_file_without_a_plan_is_lived():
    mine = Life("mine", "Mine", "spot_finding", (Phase(minutes=1.0),))
    found = planned(file=Config({"life": mine}), proposer=("fixed",))
    assert [*found.robots] == [Condition("mine", "fixed")]


def test_words_override_a_file_before_its_values_are_checked(tmp_path):
    file = tmp_path / "run.toml"
    for text, wrong, words in (
        ('kinematics.wall = "slides"', "kinematics need the body 'kinematic'", {}),
        ('device = "cuda"', "only the body 'kinematic' or the physics", {}),
        ('seed = "one"', "seed must be a whole number", {"seed": 1}),
    ):
        file.write_text(f"experiment.{text}")
        config = read_config(file)
        with pytest.raises(InputError, match=f"^with {file}: {wrong}"):
            planned(file=config, config=file)
        assert planned(file=config, config=file, body="kinematic", **words)


@pytest.mark.parametrize(
    ("words", "sentence"),
    [
        (["--life", "dancing"], "there is no life 'dancing'"),
        (["--task=spot_finding_walls"], "there is no option --task; did you mean --life?"),
        (["--proposer", "magic"], "the proposer must be one of fixed, random, creative, or"),
        (["--robots", "5", "--set", "cohort_size=2"], "multiple of the cohort size, 2, got 5"),
        (["--processes", "0"], "processes must be a whole number of at least 1, got 0"),
        (["--set", "signals=raw"], "settings and raw signals change agents only"),
        (["--agent", "dqn", "--set", "agent.rat=1"], "dqn has no setting rat: did you mean rate"),
        (["--save-every", "0"], "save-every must be positive, got 0"),
        (["--ray", "h:1", "--processes", "2"], "--processes and --ray exclude each other"),
        (["--device", "cuda", "--body", "kinematic", "--processes", "2"], "runs one job: no --ray"),
        (["--robots", "251"], "or name a cohort size"),
        (["--life", "body@13"], "the life body has the phases 1 to 12, got 'body@13'"),
        (["--proposer", "dqn"], "got 'dqn'; --agent dqn takes it"),
        (["--seed", "1", "--set", "seed=2"], "seed is given twice, by --seed and --set"),
        (["--agent", "dqn", "--brain", "steady"], "a brain is for proposers, and this run"),
        (["--agent", "dqn", "--set", "brain.epsilon=0.5"], "a brain is for proposers"),
        (["--agent", "dqn", "--set", "rate=1"], "there are agent.NAME, seed"),
        (["--set", "motor_speed=1e-320"], "motor_speed must be a number in [0.001, 10] m/s"),
    ],
)
def test_bad_input_to_run_is_one_sentence_and_nothing_is_made(words, sentence, tmp_path, capsys):
    assert cli.main(["run", str(tmp_path / "new"), *words]) == 2
    message = capsys.readouterr().err
    assert sentence in message and message.count("\n") == 1
    assert list(tmp_path.iterdir()) == []


def test_a_gpu_runs_one_job_and_a_machine_as_many_as_it_has_cores():
    numbers = {
        (n, device): options.executor(n, device=device).processes
        for n, device in ((None, "cpu"), (3, "cpu"), (None, "cuda"), (1, "cuda"))
    }
    assert [*numbers.values()] == [cores(), 3, 1, 1]


# What is simulated


def test_a_run_in_python_is_that_of_the_command(tmp_path, commands_in_process):
    options = {"life": "spot_finding", "proposer": ["creative", "random"], "robots": np.int64(2)}
    fields = {"brain.epsilon": np.float64(0.1), "brain.fixed_motors": [0.0, 0.5]}
    settings = {"set": fields, "brain": "steady"}
    run = musebot.run(tmp_path / "run", **SHORT, **options, **settings)
    assert run.conditions() == [Condition("spot_finding", name) for name in ("random", "creative")]
    assert (run.experiment.brain.epsilon, run.experiment.brain.memory_hidden) == (0.1, 10)
    before = files_below(tmp_path / "run")
    assert repr(musebot.run(str(tmp_path / "run"))) == repr(run)  # NaN is unequal to itself
    assert repr(musebot.load_run(tmp_path / "run")) == repr(run)
    assert files_below(tmp_path / "run") == before
    with pytest.raises(TypeError, match="takes the options agent, .*, got robot$"):
        musebot.run(tmp_path / "new", robot=2)
    for wrong in (
        {"robots": "2"}, {"seed": "2"}, {"processes": "1"}, {"brain": "divine"},
        {"save_every": "60"}, {"life": Path("none.toml")},
        {"set": {"brain.fixed_motors": {0.0, 0.5}}}, {"set": {"brain": BRAINS["steady"]}},
    ):  # fmt: skip
        with pytest.raises(InputError):
            musebot.run(tmp_path / "new", **wrong)
    with pytest.raises(InputError, match="out must name a folder"):
        musebot.run("")
    assert not (tmp_path / "new").exists()


def test_a_folder_keeps_its_experiment_and_refuses_another(tmp_path, capsys, commands_in_process):
    out = str(tmp_path / "run")
    short = "--robots 2 --time-scale 0.001 --life spot_finding --proposer creative".split()
    assert cli.main(["run", out, *short, "--brain", "steady", "--body", "kinematic"]) == 0
    assert "brain: steady, body: kinematic, all durations times 0.001" in capsys.readouterr().out
    before = files_below(Path(out))
    for words, sentence in (
        (["--seed", "7"], "holds an experiment with seed 1, not 7"),
        (["--brain", "paper"], "holds an experiment with brain."),
        (["--set", "kinematics.lag=0.1"], "with kinematics.lag 0.0, not 0.1"),
    ):
        assert cli.main(["run", out, *words]) == 2
        assert sentence in capsys.readouterr().err
    assert files_below(Path(out)) == before
    assert cli.main(["run", out, "--robots", "4", "--brain", "steady"]) == 0
    assert read_manifest(Path(out)).robots == {SF: 4}


def test_a_run_is_repeated_by_its_own_manifest(tmp_path, commands_in_process):
    first, again = tmp_path / "first", tmp_path / "again"
    musebot.run(first, **SHORT, robots=2, proposer="random", brain="steady")
    musebot.run(again, config=first / MANIFEST, quiet=True)
    assert read_manifest(again) == read_manifest(first)
    assert repr(musebot.load_run(again).results) == repr(musebot.load_run(first).results)


TINY = "--robots 2 --time-scale 0.001 --body kinematic --proposer fixed".split()
OWN = """
name = "swap"
task = "spot_finding"

[[phases]]
minutes = 300
spot = "random"
every_minutes = 60

[[phases]]
minutes = 300
spot = "random"
world = {wheels = [0, 1, 1, 0], nose = 90, sensors = [["nose", 1, -1]]}
"""


def test_a_life_of_a_file_is_that_of_the_run_and_of_its_manifest(
    tmp_path, capsys, commands_in_process
):
    file, out, again = (tmp_path / name for name in ("own.toml", "out", "again"))
    file.write_text(OWN)
    assert cli.main(["run", str(out), "--life", str(file), "swap@2", "body", *TINY]) == 0
    printed = capsys.readouterr().out
    for words in ("### swap, body", "### swap, newborn of phase 2", "share of time in the spot |"):
        assert words in printed
    run = musebot.load_run(out)
    assert [c.life for c in run.conditions()] == ["body", "swap", "swap@2"]
    assert run.experiment.life == read_life(file)
    assert [len(run.curves(c)[0]) for c in run.conditions()] == [1, 1, 1]
    file.unlink()
    assert cli.main(["run", str(out)]) == 0
    assert cli.main(["run", str(again), "--config", str(out / MANIFEST)]) == 0
    assert repr(musebot.load_run(again).results) == repr(run.results)
    file.write_text(OWN.replace("nose = 90", "nose = 91"))
    capsys.readouterr()
    assert cli.main(["run", str(out), "--life", str(file)]) == 2
    assert "with life.phases.2.world.nose 90, not 91" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("old", "new", "sentence"),
    [
        ('"swap"', '"body"', "there is a life or task body already"),
        ('"swap"', '"swap@2"', "a name with @ is that of a newborn's life, got 'swap@2'"),
        ('"spot_finding"', '"spot_findin"', "task must be one of ['spot_finding', "),
        ('"spot_finding"', '"wall_avoidance"', "the sensors of this task are "),
        ("nose = 90", "nose = 361", "phase 2: nose must be a number in [-360, 360] degrees"),
        ("minutes = 300", "minute = 300", "a phase has the fields stage, minutes, "),
        ('spot = "random"', "robot = [5, 5, 0]", "robot must be inside the arena"),
        ("[[phases]]", "[[phases", "own.toml: "),
    ],
)
def test_a_bad_life_is_one_sentence_and_nothing_is_made(old, new, sentence, tmp_path, capsys):
    file = tmp_path / "own.toml"
    file.write_text(OWN.replace(old, new))
    assert cli.main(["run", str(tmp_path / "new"), "--life", str(file), *TINY]) == 2
    message = capsys.readouterr().err
    assert sentence in message and message.count("\n") == 1
    assert list(tmp_path.iterdir()) == [file]


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
