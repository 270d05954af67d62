"""One page about a run, complete in itself: tables, claims, figures and films."""

from __future__ import annotations

import base64
import contextlib
import dataclasses
import os
from collections.abc import Callable, Iterator
from html import escape
from pathlib import Path

from matplotlib.figure import Figure

from ..analysis.claims import Evidence, Finding, judge_all
from ..errors import InputError
from ..experiment.experiment import Experiment
from ..experiment.schedules import NAMES, SCHEDULES
from ..playback import observation as probes
from ..playback.film import film
from ..playback.stored_brains import Candidate
from ..results.results import Results
from ..storage import check_place, write_atomically
from ..terminal import bar
from . import figures, tables
from . import robot_figures as portraits

PAGE = "report.html"
_FILM_SECONDS = 10.0
_FILM_SPEEDS = {"wall_avoidance": 6.0, "spot_finding": 60.0}
_COLUMNS = 3  # conditions side by side, on a telephone


@dataclasses.dataclass(frozen=True)
class Picture:
    """A figure of the page.

    Attributes:
      name: of its files.
      title: its heading.
      caption: what it shows, in a sentence or two.
      draw: makes it; None where there is nothing to show.
    """

    name: str
    title: str
    caption: str
    draw: Callable[[], Figure | None]


def report(experiment: Experiment, results: Results, out: Path, output: Path | None) -> Path:
    """Writes OUT/figures/, films where they can be made, and the page.

    Args:
      experiment: of the run.
      results: of the run.
      out: the run's folder.
      output: the page, an .html; None for `report.html` in `out`.

    Returns:
      The page's path.

    Raises:
      InputError: it cannot be written there; nothing was.
      OSError: something could not be written.
    """
    output = output or out / PAGE
    _check(out, output)
    pictures: list[tuple[Picture, Path]] = []
    total = probes.ticks(experiment, results) + portraits.ticks(experiment, results)
    with _progress(total) as tick, figures.styled():
        behaviour = probes.observe(experiment, results, tick)
        for picture in _pictures(experiment, results, behaviour, tick):
            if (figure := picture.draw()) is not None:
                paths = figures.save(figure, out / "figures", picture.name)
                pictures.append((picture, next(p for p in paths if p.suffix == ".png")))
    findings = judge_all(Evidence(experiment, results, behaviour))
    films, missing = _films(experiment, results, out / "films")
    page = _page(experiment, results, findings, pictures, films, missing)
    write_atomically(output, page.encode())
    return output


def _check(out: Path, output: Path) -> None:
    if output.suffix.lower() not in (".html", ".htm"):
        raise InputError(f"the report must be an .html file, got {output}")
    check_place(output)
    if not os.access(out, os.W_OK | os.X_OK):
        raise InputError(f"{out} cannot be written")
    for folder in (out / "figures", out / "films"):
        if folder.exists() and not (folder.is_dir() and os.access(folder, os.W_OK | os.X_OK)):
            raise InputError(f"{folder} cannot be written")


@contextlib.contextmanager
def _progress(total: int) -> Iterator[Callable[[], None]]:
    with bar() as progress:
        task = progress.add_task("watching robots", total=total)
        yield lambda: progress.advance(task)


def _pictures(
    experiment: Experiment, results: Results, behaviour: probes.Behaviour, tick: probes.Tick
) -> list[Picture]:
    tasks = results.tasks()
    found = [
        Picture(
            "learning_curves",
            "A life's course",
            "Means over all valid robots of a condition, with 95 % bootstrap bands.",
            lambda: figures.learning_curves(experiment, results),
        ),
        Picture(
            "categories",
            "Who learned",
            "The rows of tables 1 and 2, here and in the paper.",
            lambda: figures.categories(experiment, results),
        ),
        Picture(
            "learn_ability",
            "Learn Ability",
            "Share of the measured robots. The full bars at the ends are L = -1 and L = 1 "
            "themselves, the light ones what lies between.",
            lambda: figures.abilities(results),
        ),
    ]
    for task in tasks:
        name = NAMES[task].lower()
        minutes = portraits.MINUTES[task] * experiment.time_scale
        found += [
            Picture(
                f"trajectories_{task}",
                f"Single robots, {name}",
                f"The first {minutes:g} minutes of the test, from the ring to the dot; red is "
                f"{SCHEDULES[task].event}. The learner gained most between the two tests, the "
                "spoiled robot lost most. Stored brains, re-enacted: their noise is drawn anew.",
                lambda task=task: portraits.trajectories(experiment, results, task, tick),
            ),
            Picture(
                f"values_{task}",
                f"What actions are worth, {name}",
                "Every action's value in three situations, from blue, the least in its panel, to "
                "yellow, the most (the numbers are the two). White dots are the actions proposed "
                "in one step, the ring is the chosen one.",
                lambda task=task: portraits.values(experiment, results, task),
            ),
        ]
    if behaviour.spinning:
        found.append(
            Picture(
                "spinning",
                "Spinning",
                f"A dot is a robot, the first {probes.SAMPLE} of each condition; the line is their "
                "mean. In a second of spinning a robot turns by more than 1 rad and goes less than "
                f"2 cm. The first {probes.SPIN_MINUTES * experiment.time_scale:g} minutes of the "
                "test, re-enacted.",
                lambda: figures.spinning(behaviour),
            )
        )
    if behaviour.stays:
        found.append(
            Picture(
                "stays",
                "At the spot",
                "Robots that found the spot in training (there for a tenth of it or more), newborn "
                "again, set before it, learning: how much of their time at the spot they go along "
                "its contour (nose within 2 cm of the rim) or spin inside it. In the titles, how "
                "many spent a tenth of the time there.",
                lambda: figures.stays(behaviour.stays),
            )
        )
    return found


# ---- Films ----


def _films(
    experiment: Experiment, results: Results, folder: Path
) -> tuple[list[tuple[str, Path]], str]:
    """The films in the run's folder with their captions, one made for a task that has none.

    A film's name is its caption, and begins with its task. The second value says what is missing.
    """
    missing: list[str] = []
    for task in results.tasks():
        if any(path.name.startswith(task) for path in _kept(folder)):
            continue
        sitter = portraits.favourite(results, task)
        if sitter is None:
            missing.append(f"{NAMES[task]} has no valid robot to film.")
            continue
        proposer, speed = portraits.proposer_of(results, task), _FILM_SPEEDS[task]
        who = f"{sitter.kind}_{proposer.replace(':', '.')}_{sitter.robot}"
        path = folder / f"{task}_{who}_after_training_x{speed:g}.mp4"
        existed = folder.is_dir()
        folder.mkdir(exist_ok=True)
        try:
            candidate = Candidate(
                experiment, results, task, proposer, sitter.robot, "post", probes.SEED
            )
            film(candidate.episode(), path, seconds=_FILM_SECONDS, speed=speed)
        except InputError as error:
            if not existed:
                folder.rmdir()
            missing.append(f"{NAMES[task]} has no film: {error}.")
    films = [(path.stem.replace("_", " "), path) for path in _kept(folder)]
    return films, " ".join(missing)


def _kept(folder: Path) -> list[Path]:
    return sorted(path for path in folder.glob("*.mp4") if not path.name.startswith("."))


# ---- The page ----


def _page(
    experiment: Experiment,
    results: Results,
    findings: list[Finding],
    pictures: list[tuple[Picture, Path]],
    films: list[tuple[str, Path]],
    missing: str,
) -> str:
    tasks = results.tasks()
    body = "MuJoCo" if experiment.body == "mujoco" else "a stand-in without physics"
    facts = [f"in {body}", f"{len(results.robots)} robots", f"seed {experiment.seed}"]
    facts += tables.particulars(experiment)
    claims = [
        "<h2>The claims of section 4</h2>",
        f"<p class=note>{escape(tables.claims_note(experiment))}</p>",
        *(_claims(task, findings) for task in tables.TITLES),
    ]
    body = [
        "<h1>Musebot</h1>",
        f"<p>Mayer's creative robot (2004) {escape(', '.join(facts))}.</p>",
        *(_table(experiment, results, task) for task in tasks),
        f"<p class=note>{_emphasis(tables.NOTE)}</p>",
        *(claims if findings else []),
        *(_figure(picture, path) for picture, path in pictures),
        "<h2>Films</h2>",
        *(_film(caption, path) for caption, path in films),
    ]
    if missing:
        body.append(f"<p class=note>{escape(missing)}</p>")
    return _HEAD + "\n".join(body) + "\n</main></body></html>\n"


def _table(experiment: Experiment, results: Results, task: str) -> str:
    """A table, as several if it has many conditions: ours, its interval, the paper's."""
    proposers = results.proposers_of(task)
    parts = [f"<h2>{escape(tables.title(task, experiment))}</h2>"]
    for first in range(0, len(proposers), _COLUMNS):
        group = proposers[first : first + _COLUMNS]
        rows = [[escape(name)] for name in (*tables.row_names(task), "total variation")]
        for proposer in group:
            column = tables.ours(experiment, results, task, proposer)
            paper = tables.papers(experiment, task, proposer)
            own = [*tables.cells(column), tables.variation_cells(column, paper)]
            theirs = [*tables.cells(paper), ("", "")] if paper else [("", "")] * len(own)
            for row, cell, other in zip(rows, own, theirs, strict=True):
                value, interval = map(escape, cell)
                text = f"{value}<small>{interval}</small>" if interval else value
                text += f"<small class=paper>{escape(other[0])}</small>" if other[0] else ""
                row.append(text)
        heads = "".join(f"<th style='color:{figures.colour(p)}'>{escape(p)}</th>" for p in group)
        lines = [f"<tr><th></th>{heads}</tr>"]
        lines += [
            f"<tr><th>{row[0]}</th>{''.join(f'<td>{cell}</td>' for cell in row[1:])}</tr>"
            for row in rows
        ]
        parts.append(f"<table>{''.join(lines)}</table>")
    parts.append("<p class=note>Ours, its interval, and <span class=paper>the paper's</span>.</p>")
    return "\n".join(parts)


def _claims(task: str, findings: list[Finding]) -> str:
    items = [
        f"<li><span class='verdict {finding.verdict.replace(' ', '-')}'>{finding.verdict}</span> "
        f"<b>{escape(finding.claim.says)}</b><small>{escape(finding.words)}</small></li>"
        for finding in findings
        if finding.claim.task == task
    ]
    return f"<h3>{escape(tables.TITLES[task])}</h3>\n<ul>{''.join(items)}</ul>"


def _figure(picture: Picture, path: Path) -> str:
    return (
        f"<h2>{escape(picture.title)}</h2>\n<figure><img src='{_data(path, 'image/png')}' "
        f"alt='{escape(picture.title, quote=True)}'><figcaption>{escape(picture.caption)}"
        "</figcaption></figure>"
    )


def _film(caption: str, path: Path) -> str:
    return (
        f"<figure><video controls loop muted playsinline preload=auto "
        f"src='{_data(path, 'video/mp4')}'></video>"
        f"<figcaption>{escape(caption)}</figcaption></figure>"
    )


def _data(path: Path, kind: str) -> str:
    return f"data:{kind};base64,{base64.b64encode(path.read_bytes()).decode()}"


def _emphasis(text: str) -> str:
    first, inner, last = escape(text).split("*")
    return f"{first}<em>{inner}</em>{last}"


_HEAD = """<!doctype html>
<html lang="en"><head><meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<title>Musebot</title>
<style>
:root { color-scheme: light dark; --ink: #1b222b; --dim: #5d6773; --line: #d9dde2; --page: #fff; }
@media (prefers-color-scheme: dark) {
  :root { --ink: #e6e9ed; --dim: #98a2ae; --line: #343b45; --page: #14171c; }
}
* { box-sizing: border-box; }
body { margin: 0; background: var(--page); color: var(--ink);
  font: 16px/1.5 system-ui, sans-serif; }
main { max-width: 46rem; margin: 0 auto; padding: 1rem; overflow-wrap: anywhere; }
h1 { margin: 1rem 0 0; }
h2 { margin: 2.5rem 0 .5rem; font-size: 1.25rem; }
table { width: 100%; border-collapse: collapse; table-layout: fixed;
  font-size: .85rem; margin: 1rem 0;
  font-variant-numeric: tabular-nums; line-height: 1.3; overflow-wrap: normal; }
th, td { border-bottom: 1px solid var(--line); padding: .35rem .2rem; vertical-align: top;
  text-align: right; }
th:first-child { text-align: left; width: 25%; font-weight: normal; }
small { display: block; color: var(--dim); font-size: .75rem; }
.paper { color: var(--dim); font-style: italic; }
.note, figcaption { color: var(--dim); font-size: .85rem; }
ul { list-style: none; padding: 0; }
li { margin: 0 0 .9rem; }
.verdict { display: inline-block; border: 1px solid; border-radius: 1em; padding: 0 .6em;
  font-size: .75rem; color: #858e99; }
.verdict.holds { color: #3b87c4; }
.verdict.does-not-hold { color: #cf7423; }
figure { margin: .5rem 0; }
img, video { display: block; width: 100%; height: auto; }
figcaption { margin-top: .4rem; }
</style></head><body><main>
"""
