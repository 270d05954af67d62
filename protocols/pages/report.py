"""Writes the report of a run: one page with its tables, claims, figures and films."""

from __future__ import annotations

import base64
from collections.abc import Iterator, Mapping
from pathlib import Path

import jinja2
from markdown_it import MarkdownIt
from markupsafe import Markup
from matplotlib.figure import Figure

from ... import __version__
from ..agents.names import short_name
from ..analysis.behaviour import Behaviour
from ..errors import InputError
from ..runs.conditions import Condition
from ..runs.run import Run
from ..storage import (
    check_own_folder,
    checked_file,
    locked,
    remove_drafts,
    resolved,
    write_text,
)
from ..terminal import printable
from . import figures, markdown, measured_behaviour, robot_figures, style, tables
from . import film as films
from .replay import BRAINS_OF_TESTS, StoredRobot, minutes_of_test

PAGE = "report.html"
_TEMPLATE = Path(__file__).with_name("report.html.jinja")
_FILM_SECONDS = 6.0
_FILM_SPEEDS = {True: 60.0, False: 6.0}  # by `Life.wanted`


def report(run: Run, out: Path, output: Path | None) -> Path:
    """Writes a run's figures and page, and renders films that do not exist yet, if possible.

    `out` is the run's folder, which gets the figures in `figures/`. The page is `output`, an .html
    file; None means `report.html` in `out`. Returns the page's path.

    Raises:
      InputError: a path cannot be written, or another process writes the report; no file was
        changed.
      OSError: a file could not be written.
    """
    output = output or out / PAGE
    out, page_file = resolved(out), checked_file(output)  # links below them are not followed
    if page_file.suffix.lower() not in (".html", ".htm"):
        raise InputError(f"the report must be an .html file, got {page_file}")
    for folder in (out / "figures", out / "films"):
        check_own_folder(folder)
    with locked(out / "figures"):
        for folder in (out / "figures", out / "films"):
            remove_drafts(folder)
        remove_drafts(page_file.parent, page_file.name)
        behaviour, drawn = measured_behaviour.observe(run), {}
        with style.styled():
            for name, figure in _figures(run, behaviour):
                if figure is not None:
                    style.save(figure, out / "figures", name)
                    drawn[name] = out / "figures" / f"{name}.png"
        captions, missing = _film(run, out / "films")
        text = tables.markdown(run, behaviour, narrow=True)
        write_text(page_file, page(run, text, drawn, captions, missing))
    return output


def _figures(run: Run, behaviour: Behaviour) -> Iterator[tuple[str, Figure | None]]:
    """Yields the name of each figure's file and the figure, or None if it would be empty."""
    yield "learning_curves", figures.learning_curves(run)
    yield "categories", figures.categories(run)
    yield "learn_ability", figures.abilities(run)
    for task in run.tasks():
        yield f"trajectories_{task}", robot_figures.trajectories(run, task)
        yield f"values_{task}", robot_figures.values(run, task)
    if behaviour.spinning:
        yield "spinning", figures.spinning(run, behaviour)
    if behaviour.stays:
        yield "stays", figures.stays(behaviour.stays)


def _film(run: Run, folder: Path) -> tuple[dict[Path, str], str]:
    """Films each task's example robot before and after training, unless the film exists.

    Returns captions by film, and a sentence about robots that cannot be filmed.
    """
    captions: dict[Path, str] = {}
    missing: list[str] = []
    for task in run.tasks():
        example, life = robot_figures.favourite(run, task), run.experiment.life_of(task)
        if example is None:
            missing.append(
                f"{life.title}: this page films robots with a brain in tests; `musebot film` films "
                "others."
            )
            continue
        condition, speed = example.condition, _FILM_SPEEDS[life.wanted]
        kind = f"{example.kind}_{condition.proposer}_{example.robot}"
        folder.mkdir(exist_ok=True)
        try:
            path = folder / f"{task}_{kind}_x{speed:g}.mp4"
            if path.is_symlink() or not path.is_file():  # a link could lead to any file
                robots = (StoredRobot(run, condition, example.robot, p) for p in BRAINS_OF_TESTS)
                episodes = (robot.episode() for robot in robots)
                films.film(episodes, path, seconds=_FILM_SECONDS, speed=speed)
            captions[path] = (
                f"{life.title}: {condition.proposer} robot {example.robot} ({example.kind}) "
                f"before and after training, {speed:g} times real time"
            )
        except InputError as error:
            missing.append(f"{life.title} has no film: {error}.")
    return captions, " ".join(missing)


# ---- The page ----


def page(
    run: Run, text: str, drawn: Mapping[str, Path], filmed: Mapping[Path, str], missing: str
) -> str:
    """Returns the report as HTML that needs no other file.

    `text` is Markdown. `drawn` has figures (.png) by name, `filmed` has captions by film (.mp4).
    `missing` is a sentence about missing films, or empty.
    """
    template = jinja2.Template(
        _TEMPLATE.read_text("utf-8"),
        autoescape=True,
        trim_blocks=True,
        lstrip_blocks=True,
        undefined=jinja2.StrictUndefined,
    )
    return template.render(
        name=printable(run.name),
        summary=_summary(run),
        few=run.few,
        facts=_facts(run),
        made=f"musebot {__version__}",
        text=Markup(MarkdownIt("js-default").render(text)),
        figures={name: _uri(path, "image/png") for name, path in drawn.items()},
        films=[(caption, _uri(path, "video/mp4")) for path, caption in filmed.items()],
        missing=missing,
        tasks=[
            {
                "name": task,
                "title": life.title.lower(),
                "event": life.event,
                "minutes": f"{minutes_of_test(run, task, robot_figures.MINUTES[life.wanted]):g}",
                "kinds": [one.kind for one in robot_figures.examples(run, task)],
            }
            for task in run.tasks()
            if (life := run.experiment.life_of(task)).tested
        ],
        sample=measured_behaviour.SAMPLE,
        spin_minutes=f"{measured_behaviour.SPIN_MINUTES * run.experiment.time_scale:g}",
    )


def _uri(path: Path, kind: str) -> str:
    return f"data:{kind};base64,{base64.b64encode(path.read_bytes()).decode()}"


def _summary(run: Run) -> str:
    """Returns a sentence on the results of creative robots, or else of the first proposer's."""
    found = []
    for task in run.tasks():
        life, proposers = run.experiment.life_of(task), run.proposers(task)
        proposer = "creative" if "creative" in proposers else proposers[0]
        condition, event = Condition(task, proposer), life.event
        if not (number := len(run.valid(condition))):
            continue
        who = f"{number} {short_name(proposer)} {'robot was' if number == 1 else 'robots were'}"
        if life.tested:
            before, after = (run.shares(condition, part).mean() for part in ("pre", "post"))
            share = f"{_percent(before)} of the test before training and {_percent(after)} after it"
        else:
            share = f"{_percent(run.life_shares(condition).mean())} of the time"
        found.append(f"In {life.title.lower()}, {who} {event} for {share}")
    return f"{'; '.join([*found[:1], *(f'i{one[1:]}' for one in found[1:])])}." if found else ""


def _percent(share: float) -> str:
    """Returns a share in per cent, with two digits; as a whole number from 10 % on."""
    return f"{100 * share:.0f} %" if share >= 0.095 else f"{100 * share:.2g} %"


def _facts(run: Run) -> list[str]:
    simulators = {"mujoco": "in MuJoCo", "kinematic": "in the kinematic simulator"}
    robots = sum(len(run.robots(condition)) for condition in run.conditions())
    count = f"{robots} robot" if robots == 1 else f"{robots} robots"
    facts = [simulators[run.experiment.body], count, f"seed {run.experiment.seed}"]
    return [*facts, *markdown.particulars(run.experiment)]
