"""`musebot figure`: what it writes, and what it refuses before it writes anything."""

import pytest

from musebot.protocols.cli import parser as cli
from musebot.protocols.lives.conditions import Condition
from musebot.protocols.lives.experiment import Experiment
from musebot.protocols.lives.manifest import write_manifest
from musebot.protocols.lives.plan import Plan
from musebot.protocols.lives.run import Robot
from musebot.protocols.lives.run_files import write_results
from musebot.protocols.pages import typical_robots


def test_the_architecture_is_written_as_an_svg(tmp_path, capsys):
    path = tmp_path / "architecture.svg"
    assert cli.main(["figure", "architecture", str(path), "--task", "spot_finding"]) == 0
    assert "creative memory: 1-5-2" in path.read_text()
    assert capsys.readouterr().out == f"{path}\n"
    again = tmp_path / "again.svg"
    assert cli.main(["figure", "architecture", str(again), "--task", "spot_finding"]) == 0
    assert again.read_bytes() == path.read_bytes()


@pytest.mark.parametrize(
    ("words", "sentence"),
    [
        (["robot", "robot.gif"], "the figure must be one of .svg, .png"),
        (["robot", "robot.png", "run"], "only typical takes one"),
        (["typical", "typical.png"], "typical needs the folder of a run"),
        (["robot", "robot.png", "--task", "spot_finding"], "--task chooses the architecture"),
        (["architecture", "a.png", "--task", "night"], "the task must be one of wall_avoidance"),
        (["typical", "typical.png", "nothing"], "there is no folder nothing"),
    ],
)
def test_bad_input_is_one_sentence_and_writes_nothing(
    words, sentence, tmp_path, capsys, monkeypatch
):
    monkeypatch.chdir(tmp_path)
    assert cli.main(["figure", *words]) == 2
    complaint = capsys.readouterr().err
    assert sentence in complaint and complaint.count("\n") == 1
    assert list(tmp_path.iterdir()) == []


def test_a_run_without_typical_robots_is_one_sentence_and_writes_nothing(
    tmp_path, capsys, monkeypatch, invented
):
    condition = Condition("wall_avoidance", "fixed")
    experiment = Experiment(cohort_size=1, time_scale=0.05)
    row = Robot("wall_avoidance", "fixed", 1, 0, 0, 12.5, 0.0, 1.0, "L = 1")
    write_manifest(tmp_path / "run", Plan(experiment, {condition: 1}))
    write_results(tmp_path / "run", experiment, {condition: invented(experiment, [row])})
    monkeypatch.setattr(typical_robots, "draw", lambda run, advance: None)
    assert cli.main(["figure", "typical", str(tmp_path / "new.png"), str(tmp_path / "run")]) == 2
    assert "has no typical robots: no stored brain spins or arrives" in capsys.readouterr().err
    assert [path.name for path in tmp_path.iterdir()] == ["run"]
