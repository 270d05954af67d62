"""Links, foreign folders, names of every kind and odd machines: nothing foreign is touched."""

import io
import os
import subprocess
import sys

import pytest
from hostile import oracle

from musebot.protocols.cli import parser as cli
from musebot.protocols.pages import measured_behaviour, report

SHORT = "--robots 1 --time-scale 0.001 --body kinematic --proposer creative --life wall_avoidance"


@pytest.fixture
def victim(tmp_path):
    """A folder of the user's, next to OUT."""
    folder = tmp_path / "victim"
    folder.mkdir()
    for name in ("notes.txt", "wall_avoidance-creative-0000.safetensors", "learning_curves.png"):
        (folder / name).write_text("mine")
    (folder / "wall_avoidance_mine.mp4").write_bytes(b"mine")
    return folder


@pytest.fixture
def run(tmp_path, commands_in_process):
    """A finished run."""
    assert cli.main(["run", str(tmp_path / "out"), *SHORT.split()]) == 0
    return tmp_path / "out"


def refused(capsys, words, *kept):
    """Runs a command that must be refused and change nothing; returns its sentence."""
    before = oracle.snapshot(*kept)
    capsys.readouterr()
    assert cli.main([*map(str, words)]) == 2
    said = capsys.readouterr().err
    assert said.count("\n") == 1 and said.startswith("musebot: "), said
    assert oracle.snapshot(*kept) == before
    return said


# ---- Links below OUT ----


def test_a_link_in_the_place_of_what_is_ours_is_refused(run, victim, capsys):
    for place, words in (
        ("checkpoints", "run OUT"),
        ("checkpoints", "run OUT --robots 2"),
        ("figures", "report OUT"),
        ("films", "report OUT"),
        ("page.html", "report OUT --output OUT/page.html"),
        ("film.mp4", "film OUT --task wall_avoidance --output OUT/film.mp4"),
    ):
        (run / place).symlink_to(victim / "notes.txt" if "." in place else victim)
        said = refused(capsys, words.replace("OUT", str(run)).split(), run, victim)
        assert f"{run / place} is a link" in said
        (run / place).unlink()


# ---- Files that are not ours ----


def test_a_file_of_the_users_in_a_run_stays(run):
    names = (".novel.2024.draft", "checkpoints/notes.txt", "figures/mine.svg")
    for name in names:
        (run / name).parent.mkdir(exist_ok=True)
        (run / name).write_text("mine")
    assert cli.main(["run", str(run), "--robots", "2"]) == 0
    assert [(run / name).read_text() for name in names] == ["mine"] * 3


# ---- Names ----

NAME = "a[/]b [red]x[/red] two\nlines \x1b[2J \udcff \u202egpj 🤖 a|b*_`<i>"


def test_an_out_of_any_name_holds_a_run_its_tables_and_its_report(
    tmp_path, capsys, monkeypatch, commands_in_process
):
    out = tmp_path / NAME
    assert cli.main(["run", str(out), *SHORT.split()]) == 0
    assert cli.main(["tables", str(out)]) == 0
    (out / "checkpoints").mkdir()
    damaged = out / "checkpoints" / "wall_avoidance-creative-0001.finished.safetensors"
    damaged.write_bytes(b"damaged")
    assert cli.main(["run", str(out), "--robots", "2"]) == 0
    printed = capsys.readouterr().err
    assert "\x1b[2J" not in printed and "set aside" in printed
    behaviour = measured_behaviour.Behaviour({}, {})
    monkeypatch.setattr(measured_behaviour, "observe", lambda run: behaviour)
    monkeypatch.setattr(report, "_figures", lambda *_: iter(()))
    monkeypatch.setattr(report, "_film", lambda *_: ({}, "no film"))
    assert cli.main(["report", str(out)]) == 0
    page = (out / "report.html").read_text()
    assert "<i>" not in page and "\x1b" not in page
    printed = capsys.readouterr()
    assert "\x1b" not in printed.out and "\x1b[2J" not in printed.err


def test_an_out_that_the_system_could_not_name_is_refused_and_a_long_one_is_not(
    tmp_path, capsys, commands_in_process
):
    for name in ("x/" * 1900, f"{'y' * 250}/" * 15, "z" * 300):
        refused(capsys, ["run", tmp_path / name], tmp_path)
    out = tmp_path.joinpath(*["y" * 250] * 3)
    assert cli.main(["run", str(out), *SHORT.split()]) == 0
    assert cli.main(["tables", str(out)]) == 0


# ---- Streams and machines ----


def test_a_closed_stream_or_one_of_ascii_changes_no_status_and_no_result(run, monkeypatch):
    tables = (run / "tables.md").read_bytes()
    for stream in ("stdout", "stderr"):
        with monkeypatch.context() as patch:
            patch.setattr(sys, stream, None)
            assert cli.main(["run", str(run)]) == 0
            assert cli.main(["tables", str(run)]) == 0
            assert cli.main(["tables", str(run / "nothing")]) == 2
    assert (run / "tables.md").read_bytes() == tables
    out = io.TextIOWrapper(io.BytesIO(), encoding="ascii", errors="strict")
    monkeypatch.setattr(sys, "stdout", out)
    assert cli.main(["tables", str(run), "--compare", str(run)]) == 0
    assert cli.main(["list"]) == 0
    out.seek(0)
    assert out.read().isascii()


# Without the main guard.
SCRIPT = """
import musebot

print("read")
short = {"robots": 1, "time_scale": 0.001, "body": "kinematic", "processes": 1}
run = musebot.run("bare", life="wall_avoidance", proposer="creative", **short)
print(len(run.robots(run.conditions()[0])))
"""


def test_a_script_on_a_bare_machine_simulates_once_to_the_same_bytes_and_umask_is_obeyed(
    run, tmp_path
):
    bare = tmp_path / "bare"
    (tmp_path / "script.py").write_text(SCRIPT)
    environment = {"TMPDIR": str(tmp_path / "nothing"), "LC_ALL": "C", "PYTHONHASHSEED": "7"}
    # The instructions that PyTorch computes with are the machine's, not the environment's.
    kept = ("ATEN_CPU_CAPABILITY", "PYTHONPATH")  # the latter where a copy is tested
    environment |= {name: os.environ[name] for name in kept if name in os.environ}
    done = subprocess.run(
        [sys.executable, "script.py"],
        env=environment, cwd=tmp_path, umask=0o077, capture_output=True, text=True,
    )  # fmt: skip
    assert done.stdout.split() == ["read", "1"], done.stderr
    assert "100.0 %, 1 of 1 robots done" in done.stderr
    for name in ("robots.csv", "results.safetensors.gz"):
        assert (bare / name).read_bytes() == (run / name).read_bytes()
        assert (bare / name).stat().st_mode & 0o077 == 0
    assert bare.stat().st_mode & 0o077 == 0
