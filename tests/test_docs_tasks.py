"""The tables in docs/tasks.md and docs/own-robot.md and the pages of tasks match the code."""

import re
from pathlib import Path

from PIL import Image

import musebot
from musebot.models import arena
from musebot.protocols.cli.film import Film
from musebot.protocols.cli.parser import parsed
from musebot.tasks.episode import CONTROL_TIMESTEP
from musebot.tasks.suite import SUITE, TASKS

PAGE = Path(__file__).parents[1] / "docs" / "tasks.md"
TEXT = PAGE.read_text()
TABLE = (
    "task",
    "Gymnasium id",
    "actions",
    "episode",
    "reward",
    "drawn at the start",
    "measured time",
)
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
        assert film.stat().st_size < 300_000
        assert f"(../../images/{name}.gif)" in page
        (words,) = re.findall(r"^Reproduce: `musebot film (.*)`$", page, re.MULTILINE)
        made = parsed(Film, "musebot film", words.split())
        assert (made.task, made.output.name, made.out) == (name, film.name, None)


def test_the_table_matches_the_code():
    ids = {task: name for name, task in musebot.GYMNASIUM_TASKS.items()}
    assert f"| {' | '.join(TABLE)} |\n" in TEXT
    for name in SUITE:
        definition = TASKS[name]
        steps = definition.time_limit / CONTROL_TIMESTEP
        length = "endless" if steps == float("inf") else f"{steps:,.0f} steps"
        limits = f"[-{definition.limit:g}, {definition.limit:g}]"
        start = f"| [{name}](reference/tasks/{name}.md) | `musebot/{ids[name]}` | {limits} |"
        line = next(line for line in TEXT.splitlines() if line.startswith(start))
        assert f"| {length} |" in line
        cells = [cell.strip() for cell in line.strip("| ").split("|")]
        assert len(cells) == len(TABLE) and all(cells)


def test_the_table_of_a_robots_parts_has_everything_that_is_checked():
    text = (PAGE.parent / "own-robot.md").read_text()
    rows = [line.split("|")[1:3] for line in text.splitlines() if line.startswith("|")]
    for kind, names in arena._NEEDED.items():
        what = {"body": "bod"}.get(word := kind.name.removeprefix("mjOBJ_").lower(), word)
        listed = " ".join(row_names for needed, row_names in rows if what in needed)
        assert [name for name in names if f"`{name}`" not in listed] == [], word
