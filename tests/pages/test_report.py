"""The report: one page that needs no other file and fits the screen of a telephone."""

import dataclasses
import html
import json
import re
import shutil
import subprocess

import pytest
from helpers import change_physics, run_of_rows

from musebot import __version__
from musebot.protocols.cli import parser as cli
from musebot.protocols.errors import InputError
from musebot.protocols.pages import film, report, tables
from musebot.protocols.pages.report import page
from musebot.protocols.runs.experiment import Experiment
from musebot.protocols.runs.run import Robot
from musebot.protocols.runs.run_files import read_run
from musebot.tasks.lives import LIVES


def run_of(*proposers, robots=20):
    return run_of_rows([
        Robot("wall_avoidance", proposer, 1, 0, i, 6.0, 2.0, 0.5, "0 < L < 1")
        for proposer in proposers for i in range(robots)
    ], name="a & b")  # fmt: skip


@pytest.mark.parametrize("exact", [False, True])
def test_the_page_has_every_cell_note_and_verdict_of_the_tables_escaped(exact):
    run = run_of("fixed", "random", "creative")
    run = dataclasses.replace(run, exact_classes=exact)
    wide, narrow = tables.markdown(run), tables.markdown(run, narrow=True)
    text = page(run, narrow, {}, {}, "No <film>.")
    shown = " ".join(html.unescape(re.sub("<[^>]*>", " ", text)).split())
    for cell in re.split(r"[|\n*`]+", wide):
        assert cell.strip(" #-:") in shown
    assert narrow.count("fixed, ours") == wide.count("fixed, ours") == 1
    assert text.count("<table>") == 3
    assert ("rounded to two decimals" in text) == (not exact)
    for tag in ("title", "h1"):
        assert f"<{tag}>a &amp; b - Musebot report</{tag}>" in text
    assert "No &lt;film&gt;." in text and "0 < L" not in text
    assert f"musebot {__version__}<" in text and "60 robots, seed 1" in text
    said = "In wall avoidance, 20 creative robots were in contact for"
    assert said in text and text.index(said) < text.index("MuJoCo, 60 robots")


def test_captions_have_the_minutes_that_figures_show(tmp_path):
    (tmp_path / "drawn.png").write_bytes(b"drawn")
    ten = tuple(dataclasses.replace(one, minutes=10.0) for one in LIVES["spot_finding"].phases)
    life = dataclasses.replace(LIVES["spot_finding"], name="mine", phases=ten)
    for name, minutes in (("wall_avoidance", 4), ("spot_finding", 15), ("mine", 10)):
        row = Robot(name, "creative", 1, 0, 0, 6.0, 2.0, 0.5, "0 < L < 1")
        run = run_of_rows([row], Experiment(life=life))
        text = page(run, "", {f"trajectories_{name}": tmp_path / "drawn.png"}, {}, "")
        assert f"First {minutes} minutes of the test, from the ring" in text


@pytest.fixture(scope="module")
def out(directory, tmp_path_factory):
    """A copy of the run, with its report, figures and films."""
    out = tmp_path_factory.mktemp("report") / "run"
    shutil.copytree(directory, out)
    assert cli.main(["report", str(out)]) == 0
    return out


def test_a_report_says_that_the_runs_physics_was_another_one(
    directory, tmp_path, monkeypatch, capsys
):
    shutil.copytree(directory, other := tmp_path / "run")
    change_physics(other)
    monkeypatch.setattr(report, "report", lambda run, out, output: out / report.PAGE)
    for folder, said in ((directory, False), (other, True)):
        assert cli.main(["report", str(folder)]) == 0
        assert ("was simulated in another physics" in capsys.readouterr().err) == said


@pytest.mark.slow
def test_the_page_holds_every_figure_and_film_and_needs_no_other_file(out, without_egl):
    text = (out / report.PAGE).read_text()
    assert "Wall avoidance (table 1), all durations times 0.002" in text
    assert "A condition has fewer than 20 robots: nothing is tested or compared with the p" in text
    assert "p = " not in text and "paper</th>" not in text and "claims" not in text
    assert "not observed" not in text  # the robots' behaviour was measured
    figures = {path.stem for path in (out / "figures").glob("*.png")}
    assert text.count("<img ") == len(figures) >= 7
    assert {path.stem for path in (out / "figures").glob("*.svg")} == figures
    assert not re.findall(r"(?:src|href)=['\"]?(?!data:)[^'\" >]+", text)
    assert "url(" not in text and "@import" not in text
    films = [*(out / "films").glob("*.mp4")]
    assert text.count("<video ") == len(films) and bool(films) != bool(without_egl)


def test_films_that_are_missing_are_made_or_named_and_kept_ones_are_shown(
    directory, tmp_path, monkeypatch
):
    shutil.copytree(directory, tmp_path / "copy")
    copy, made = tmp_path / "copy", []
    run, output = read_run(copy, replay=True), copy / "elsewhere.html"

    def write(_, path, *, seconds, speed):
        if path in made:
            raise InputError("there is no headless OpenGL (EGL) on this machine")
        made.append(path)
        path.write_bytes(b"film")
        assert speed == {"w": 6, "s": 60}[path.name[0]]  # a spot is found in minutes

    monkeypatch.setattr(film, "film", write)
    monkeypatch.setattr(report, "_figures", lambda *_: [])
    for _ in range(2):
        report.report(run, copy, None)
    walls, spot = made
    assert walls.name.startswith("wall_avoidance_") and spot.name.startswith("spot_finding_")
    assert sorted((copy / "films").iterdir()) == sorted(made)
    spot.rename(spot.with_name("my_robot.mp4"))  # of another robot
    report.report(run, copy, output)
    text = output.read_text()
    assert text.count("<video ") == text.count("data:video/mp4;base64,ZmlsbQ==") == 1
    assert re.search("<figcaption>Wall.* before and after training, 6 times real time</figc", text)
    assert (
        "my robot" not in text and "Spot finding has no film: there is no headless OpenGL" in text
    )
    shutil.rmtree(copy / "films")
    report.report(run, copy, output)
    assert "Wall avoidance has no film" in output.read_text()


# Pictures and films hold back the load event until they are there, or have failed.
PROBE = """
const frame = document.querySelector('iframe');
window.onload = () => {
  const page = frame.contentDocument;
  const out = document.createElement('pre');
  out.textContent = 'found' + JSON.stringify({
    width: page.documentElement.scrollWidth,
    wide: [...page.querySelectorAll('body *')].filter(e =>
      e.getBoundingClientRect().right > frame.clientWidth + 0.5).map(e => e.tagName),
    images: [...page.images].map(i => i.naturalWidth),
    videos: [...page.querySelectorAll('video')].map(v => v.videoWidth),
  });
  document.body.append(out);
};
frame.srcdoc = SOURCE;
"""


def browse(text, folder, width):
    """Returns how Chromium lays out a page in a frame of some width in pixels."""
    chromium = shutil.which("chromium") or shutil.which("chromium-browser")
    if chromium is None:
        pytest.skip("there is no chromium here: apt-get install chromium")
    outer, source = folder / "outer.html", json.dumps(text).replace("</", "<\\/")
    outer.write_text(
        f"<body style='margin:0'><iframe style='border:0;width:{width}px;height:844px'></iframe>"
        f"<script>{PROBE.replace('SOURCE', source)}</script></body>"
    )
    options = "--headless --no-sandbox --disable-gpu --window-size=1000,900 --dump-dom".split()
    command = [chromium, *options, f"--user-data-dir={folder / 'profile'}", outer.as_uri()]
    done = subprocess.run(command, capture_output=True, text=True, timeout=600)
    found = re.search("<pre>found(.*?)</pre>", done.stdout)
    assert found, done.stderr[-2000:]
    return json.loads(html.unescape(found[1]))


@pytest.mark.slow
def test_a_telephones_browser_shows_every_picture_and_film_without_scrolling_sideways(
    out, tmp_path
):
    text = (out / report.PAGE).read_text()
    found = browse(text, tmp_path, 390)
    assert found["width"] <= 390 and found["wide"] == []
    assert len(found["images"]) == len([*(out / "figures").glob("*.png")])
    assert all(pixels > 1000 for pixels in found["images"])
    assert found["videos"] == [2 * 960] * len([*(out / "films").glob("*.mp4")])
    broken = text.replace("<h1>", "<p style='width:950px'>wide</p><img src='data:,'><h1>")
    found = browse(broken, tmp_path, 390)
    assert found["width"] > 390 and found["wide"] and 0 in found["images"]
