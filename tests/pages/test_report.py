"""The report: one page that needs no other file and fits the screen of a telephone."""

from __future__ import annotations

import html
import json
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from musebot.protocols.cli import parser as cli
from musebot.protocols.errors import InputError
from musebot.protocols.lives.conditions import Condition
from musebot.protocols.lives.experiment import Experiment
from musebot.protocols.lives.plan import Plan
from musebot.protocols.lives.run_files import read_run
from musebot.protocols.lives.runs import simulate
from musebot.protocols.pages import film
from musebot.protocols.pages.report import report

pytestmark = pytest.mark.slow

CONDITIONS = (
    Condition("wall_avoidance", "creative"),
    Condition("wall_avoidance", "fixed"),
    Condition("spot_finding", "creative"),
)


@pytest.fixture(scope="module")
def out(tmp_path_factory, in_process):
    directory = tmp_path_factory.mktemp("report") / "run"
    plan = Plan.of(Experiment(cohort_size=6, time_scale=0.004), CONDITIONS, 6)
    simulate(directory, plan, in_process(), quiet=True)
    return directory


@pytest.fixture(scope="module")
def page(out):
    assert cli.main(["report", str(out)]) == 0
    return out / "report.html"


@pytest.fixture(scope="module")
def draws():
    command = [sys.executable, "-m", "musebot.protocols.pages.offscreen"]
    return subprocess.run(command, capture_output=True).returncode == 0


def test_the_page_holds_tables_claims_and_every_figure(page, out):
    text = page.read_text()
    assert "Wall avoidance (table 1), all durations times 0.004" in text
    assert "260 (52%)" in text  # the paper's
    claims = text.count('class="verdict ')
    assert f"{28 - claims} of 28 claims are not judged: no robots of " in text and claims > 0
    places = [
        text.index(part) for part in ("<h2>Films", "<h2>Learning curves", "<table>", "<h2>Cat")
    ]
    assert places == sorted(places)
    assert text.count("<img ") == len(list((out / "figures").glob("*.png"))) >= 7
    assert {p.stem for p in (out / "figures").glob("*.svg")} == {
        p.stem for p in (out / "figures").glob("*.png")
    }


def test_the_page_needs_no_other_file(page):
    text = page.read_text()
    assert not re.findall(r"(?:src|href)=['\"]?(?!data:)[^'\" >]+", text)
    assert "url(" not in text and "@import" not in text


def test_films_are_in_the_page_or_the_page_says_why_not(page, out, draws):
    films = list((out / "films").glob("*.mp4"))
    assert page.read_text().count("<video ") == len(films)
    assert bool(films) == draws
    if not draws:
        assert "has no film: there is no headless OpenGL (EGL)" in page.read_text()


def test_existing_films_are_kept_and_captioned_by_their_names(out, page, tmp_path, monkeypatch):
    copy = tmp_path / "copy"
    shutil.copytree(out, copy)
    shutil.rmtree(copy / "films", ignore_errors=True)
    (copy / "films").mkdir()
    names = ["my_robot.mp4", "spot_finding.mp4", "wall_avoidance_learner.mp4"]
    for name in names:
        (copy / "films" / name).write_bytes(b"film")
    output = tmp_path / "elsewhere.html"
    monkeypatch.setattr(film, "film", without_egl)
    report(read_run(copy), copy, output)
    text = output.read_text()
    assert text.count("<video ") == text.count("data:video/mp4;base64,ZmlsbQ==") == 3
    assert "my robot" in text and "wall avoidance learner" in text
    assert sorted(p.name for p in (copy / "films").iterdir()) == names


def test_an_example_robot_without_a_film_gets_one_or_the_page_says_why(
    out, page, tmp_path, monkeypatch
):
    copy = tmp_path / "copy"
    shutil.copytree(out, copy)
    shutil.rmtree(copy / "films", ignore_errors=True)
    made, speeds = [], []

    def write(_, path, *, seconds, speed):
        made.append(path)
        speeds.append(speed)
        path.write_bytes(b"film")

    run = read_run(copy)
    monkeypatch.setattr(film, "film", write)
    report(run, copy, None)
    walls, spot = made
    assert speeds == [6, 60]  # a spot is found in minutes, a wall in seconds
    assert walls.name.startswith("wall_avoidance_") and spot.name.startswith("spot_finding_")
    report(run, copy, None)
    assert len(made) == 2
    spot.rename(
        spot.with_name(f"spot_finding_learner_creative_99{spot.suffix}")
    )  # of another robot
    report(run, copy, None)
    assert made[2:] == [spot]
    spot.unlink()
    monkeypatch.setattr(film, "film", without_egl)
    report(run, copy, None)
    text = (copy / "report.html").read_text()
    assert "Spot finding has no film: there is no headless OpenGL" in text
    assert text.count("<video ") == 2


def without_egl(*_, **__):
    raise InputError("there is no headless OpenGL (EGL) on this machine")


def test_without_egl_the_page_says_so_and_no_folder_is_left(out, page, tmp_path, monkeypatch):
    copy = tmp_path / "copy"
    shutil.copytree(out, copy)
    shutil.rmtree(copy / "films", ignore_errors=True)
    monkeypatch.setattr(film, "film", without_egl)
    report(read_run(copy), copy, None)
    assert "has no film: there is no headless OpenGL" in (copy / "report.html").read_text()
    assert not (copy / "films").exists()


# ---- In a browser ----

# Pictures and films hold back the load event until they are there, or have failed.
PROBE = """
const frame = document.querySelector('iframe');
window.onload = () => {
  const page = frame.contentDocument;
  const wide = [...page.querySelectorAll('body *')].filter(e => {
    const box = e.getBoundingClientRect();
    return box.right > frame.clientWidth + 0.5 || e.scrollWidth > e.clientWidth + 1 &&
      ['auto', 'scroll'].includes(getComputedStyle(e).overflowX);
  });
  const found = {
    frame: frame.clientWidth,
    width: page.documentElement.scrollWidth,
    wide: wide.map(e => e.tagName + ' ' + e.textContent.slice(0, 40)),
    images: [...page.images].map(i => i.naturalWidth),
    videos: [...page.querySelectorAll('video')].map(v => v.videoWidth),
  };
  const out = document.createElement('pre');
  out.id = 'found';
  out.textContent = JSON.stringify(found);
  document.body.append(out);
};
frame.srcdoc = SOURCE;
"""


def browse(page: Path, folder: Path, width: int) -> dict:
    """Returns how Chromium lays out a page in a frame of some width in pixels."""
    chromium = shutil.which("chromium") or shutil.which("chromium-browser")
    if chromium is None:
        pytest.skip("there is no chromium here: apt-get install chromium")
    source = json.dumps(page.read_text()).replace("</", "<\\/")
    outer = folder / "outer.html"
    outer.write_text(
        f"<body style='margin:0'><iframe style='border:0;width:{width}px;height:844px'></iframe>"
        f"<script>{PROBE.replace('SOURCE', source)}</script></body>"
    )
    done = subprocess.run(
        [
            chromium, "--headless", "--no-sandbox", "--disable-gpu", "--window-size=1000,900",
            f"--user-data-dir={folder / 'profile'}", "--dump-dom", outer.as_uri(),
        ],
        capture_output=True, text=True, timeout=600,
    )  # fmt: skip
    found = re.search(r"<pre id=\"found\">(.*?)</pre>", done.stdout)
    assert found, done.stderr[-2000:]
    return json.loads(html.unescape(found[1]))


@pytest.mark.parametrize("width", [390, 900])
def test_a_browser_shows_every_picture_and_film_without_scrolling_sideways(
    page, out, tmp_path, width
):
    found = browse(page, tmp_path, width)
    assert found["frame"] == width
    assert found["width"] <= width and found["wide"] == []
    assert len(found["images"]) == len(list((out / "figures").glob("*.png")))
    assert all(pixels > 1000 for pixels in found["images"])
    assert found["videos"] == [960] * len(list((out / "films").glob("*.mp4")))


def test_the_browser_detects_what_is_too_wide_or_missing(page, tmp_path):
    text = page.read_text().replace("<h1>", "<p style='width:500px'>wide</p><img src='data:,'><h1>")
    broken = tmp_path / "broken.html"
    broken.write_text(text)
    found = browse(broken, tmp_path, 390)
    assert found["width"] > 390 and found["wide"]
    assert 0 in found["images"]


# ---- Bad input ----


def listing(folder):
    return sorted(str(path.relative_to(folder)) for path in folder.rglob("*"))


@pytest.mark.parametrize(
    ("output", "words"),
    [
        ("page.pdf", "must be an .html file"),
        ("nowhere/page.html", "there is no folder"),
        ("folder.html", "is a folder"),
    ],
)
def test_an_impossible_output_is_refused_in_one_sentence_and_nothing_is_written(
    out, tmp_path, capsys, output, words
):
    (tmp_path / "folder.html").mkdir()
    before = listing(out), listing(tmp_path)
    assert cli.main(["report", str(out), "--output", str(tmp_path / output)]) == 2
    message = capsys.readouterr().err
    assert words in message and message.count("\n") == 1
    assert (listing(out), listing(tmp_path)) == before


def test_a_report_of_an_empty_folder_is_refused_and_nothing_is_written(tmp_path, capsys):
    assert cli.main(["report", str(tmp_path)]) == 2
    assert "holds no experiment of musebot's" in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == []
