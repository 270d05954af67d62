"""`musebot figure`: what it writes, and what it refuses before it writes anything."""

import pytest

from musebot.protocols import cli


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
