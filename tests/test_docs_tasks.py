"""The tables in docs/tasks.md and docs/own.md and the pages of tasks match the code."""

import importlib.util
import json
import re
from pathlib import Path

from PIL import Image

import musebot
from musebot.models import arena
from musebot.protocols.cli.film import Film
from musebot.protocols.cli.parser import parsed
from musebot.tasks.episode import CONTROL_TIMESTEP
from musebot.tasks.suite import SUITE, TASKS

ROOT = Path(__file__).parents[1]
PAGE = ROOT / "docs" / "tasks.md"
TEXT = PAGE.read_text()
REFERENCE = PAGE.parent / "reference" / "tasks"


def test_every_task_has_a_page_with_its_signals_a_picture_and_a_small_film():
    for name in SUITE:
        page, definition = (REFERENCE / f"{name}.md").read_text(), TASKS[name]
        for signal, (length, low, high) in definition.rules.shapes.items():
            cells = rf"\| `{signal}`[^|]*\| \({length},\) \| {low:g} \| {high:g} \|"
            assert re.search(cells, page), (name, signal)
        (picture,) = re.findall(r"\((\S+\.png)\)", page)
        assert (REFERENCE / picture).exists()
        film = PAGE.parent / "images" / f"{name}.gif"
        with Image.open(film) as gif:
            assert gif.n_frames == 64
        assert film.stat().st_size < 500_000
        assert f"(../../images/{name}.gif)" in page
        (words,) = re.findall(r"^Reproduce: `musebot film (.*)`$", page, re.MULTILINE)
        made = parsed(Film, "musebot film", words.split())
        assert (made.task, made.output.name, made.out) == (name, film.name, None)


def test_the_pictures_were_made_of_what_they_show_today():
    """After a change of the robot, the arena or what films draw: `make pictures`."""
    spec = importlib.util.spec_from_file_location("pictures", ROOT / "docs/generator/pictures.py")
    spec.loader.exec_module(pictures := importlib.util.module_from_spec(spec))
    assert json.loads(pictures.MADE.read_text())["digest"] == pictures.digest()
    assert all((pictures.IMAGES / name).is_file() for name in pictures.COMMANDS)
    words = pictures.COMMANDS["before-after.gif"]
    assert f"`musebot {words} --output before-after.gif`" in (ROOT / "docs/index.md").read_text()


def test_the_table_has_the_film_the_page_and_the_id_of_every_task():
    ids = {task: name for name, task in musebot.GYMNASIUM_TASKS.items()}
    for name in SUITE:
        film = f"| ![A trained policy in {name}](images/{name}.gif) "
        link = f"| [`{name}`](reference/tasks/{name}.md)<br>`musebot/{ids[name]}` |"
        assert TEXT.count(film + link) == 1
        definition = TASKS[name]
        paper = ("arena", name) in musebot.PAPER
        assert definition.limit == (0.5 if paper else 1)
        assert definition.time_limit / CONTROL_TIMESTEP == (float("inf") if paper else 1000)


def test_the_table_of_a_robots_parts_has_everything_that_is_checked():
    text = (PAGE.parent / "own.md").read_text()
    rows = [line.split("|")[1:3] for line in text.splitlines() if line.startswith("|")]
    for kind, names in arena._NEEDED.items():
        what = {"body": "bod"}.get(word := kind.name.removeprefix("mjOBJ_").lower(), word)
        listed = " ".join(row_names for needed, row_names in rows if what in needed)
        assert [name for name in names if f"`{name}`" not in listed] == [], word
