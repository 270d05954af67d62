"""Writes the report of a run: one page with its tables, claims, figures and films."""

from __future__ import annotations

import dataclasses
import os
from collections.abc import Callable, Iterator
from pathlib import Path

from matplotlib.figure import Figure

from ..analysis.behaviour import Behaviour
from ..analysis.paper_claims import judge_all
from ..errors import InputError
from ..lives.conditions import Condition
from ..lives.run import Run
from ..lives.schedules import SCHEDULES, TASK_NAMES
from ..storage import (
    check_own_folder,
    check_place,
    locked,
    remove_drafts,
    resolved,
    resolved_file,
    write_text,
)
from ..terminal import StepProgress
from . import example_robots, figures, html_page, measured_behaviour, robot_figures, style
from . import film as films
from .html_page import Medium
from .rollout import SEED, Tick
from .stored_brains import StoredRobot

PAGE = "report.html"
_FILM_SECONDS = 10.0
_FILM_SPEEDS = {"wall_avoidance": 6.0, "spot_finding": 60.0}


@dataclasses.dataclass(frozen=True)
class PlannedFigure:
    """A figure of the page that is still to be drawn.

    Attributes:
      name: Name of the figure's files, without a suffix.
      title: Heading above the figure.
      caption: Text of a few sentences that says what the figure shows.
      alt: Sentence that replaces the figure for readers who cannot see it.
      draw: Function that draws the figure; it returns None if there is nothing to show.
    """

    name: str
    title: str
    caption: str
    alt: str
    draw: Callable[[], Figure | None]


def report(run: Run, out: Path, output: Path | None) -> Path:
    """Writes the figures into OUT/figures/, the page, and missing films if they can be rendered.

    Args:
      run: The run.
      out: Folder of the run.
      output: File of the page to write, an .html; None for `report.html` in `out`.

    Returns:
      Path of the page.

    Raises:
      InputError: a path cannot be written, or another process writes the report; no file was
        changed.
      OSError: a file could not be written.
    """
    output = output or out / PAGE
    out, page_file = resolved(out), resolved_file(output)  # links below them are not followed
    _check(out, page_file)
    with locked(out / "figures"):
        for folder in (out / "figures", out / "films"):
            remove_drafts(folder)
        remove_drafts(page_file.parent, page_file.name)
        _write(run, out, page_file)
    return output


def _write(run: Run, out: Path, page_file: Path) -> None:
    drawn: list[Medium] = []
    total = measured_behaviour.ticks(run) + robot_figures.ticks(run)
    with StepProgress("observing robots", total) as progress, style.styled():
        behaviour = measured_behaviour.observe(run, progress.advance)
        for planned in _figures(run, behaviour, progress.advance):
            if (figure := planned.draw()) is not None:
                paths = style.save(figure, out / "figures", planned.name)
                png = next(path for path in paths if path.suffix == ".png")
                drawn.append(Medium(png, planned.title, planned.caption, planned.alt))
    shown, missing = _films(run, out / "films")
    page = html_page.page(run, judge_all(run, behaviour), drawn, shown, missing)
    write_text(page_file, page)


def _check(out: Path, output: Path) -> None:
    if output.suffix.lower() not in (".html", ".htm"):
        raise InputError(f"the report must be an .html file, got {output}")
    check_place(output)
    if not os.access(out, os.W_OK | os.X_OK):
        raise InputError(f"{out} cannot be written")
    for folder in (out / "figures", out / "films"):
        check_own_folder(folder)


# ---- Figures ----


def _figures(run: Run, behaviour: Behaviour, tick: Tick) -> Iterator[PlannedFigure]:
    yield PlannedFigure(
        "learning_curves",
        "Learning curves",
        "Means over all valid robots of a condition, with bands of 95 %.",
        "Lines of the mean share of the time with the event over the simulated hours of a life, "
        "one for each condition.",
        lambda: figures.learning_curves(run),
    )
    yield PlannedFigure(
        "categories",
        "Categories",
        "The rows of tables 1 and 2, here and in the paper.",
        "Stacked bars of the per cent of the robots in each category, one for each condition here "
        "and in the paper.",
        lambda: figures.categories(run),
    )
    yield PlannedFigure(
        "learn_ability",
        "Learn Ability",
        "Share of the measured robots. The solid bars at the ends are L = -1 and L = 1 themselves; "
        "the light bars are the values between.",
        "Histograms of Learn Ability from -1 to 1, one for each condition.",
        lambda: figures.abilities(run),
    )
    for task in run.tasks():
        yield _trajectories(run, task, tick)
        yield _values(run, task)
    scale = run.experiment.time_scale
    if behaviour.spinning:
        yield PlannedFigure(
            "spinning",
            "Spinning",
            f"A dot is a robot (the first {measured_behaviour.SAMPLE} of each condition); the line "
            "is their mean. In a second of spinning a robot turns by more than 1 rad and moves "
            f"less than 2 cm. First {measured_behaviour.SPIN_MINUTES * scale:g} minutes of the "
            "test, replayed with the stored brains.",
            "Dots of the share of time that each robot spins before and after training, one group "
            "for each condition.",
            lambda: figures.spinning(behaviour),
        )
    if behaviour.stays:
        yield PlannedFigure(
            "stays",
            "At the spot",
            "Robots that found the spot in training (there for at least a tenth of it) start again "
            "with their newborn brains, at the rim of the spot, and learn. Shares of their time at "
            "the spot in which they follow its contour (nose within 2 cm of the rim) or spin "
            "inside it. The titles count the robots that spent a tenth of the time there.",
            "Lines of the shares of following the contour and of spinning inside the spot, by "
            "simulated minute.",
            lambda: figures.stays(behaviour.stays),
        )


def _trajectories(run: Run, task: str, tick: Tick) -> PlannedFigure:
    minutes = robot_figures.MINUTES[task] * run.experiment.time_scale
    kinds = [one.kind for one in example_robots.examples(run, task)]
    found = example_robots.gains(kinds)
    return PlannedFigure(
        f"trajectories_{task}",
        f"Single robots, {TASK_NAMES[task].lower()}",
        f"First {minutes:g} minutes of the test, from the ring to the dot; violet is "
        f"{SCHEDULES[task].event}. {found}Replayed with the stored brains, whose noise is drawn "
        "anew.",
        f"Paths in the arena before and after training, seen from above: {', '.join(kinds)}.",
        lambda: robot_figures.trajectories(run, task, tick),
    )


def _values(run: Run, task: str) -> PlannedFigure:
    return PlannedFigure(
        f"values_{task}",
        f"Values of actions, {TASK_NAMES[task].lower()}",
        "Value of every action in three situations, from blue, the lowest in its panel, to yellow, "
        "the highest (the two numbers). White dots are the ideas of one step, the ring is the "
        "chosen one.",
        "Maps of the value of each pair of motor values before and after training, one for each "
        "situation.",
        lambda: robot_figures.values(run, task),
    )


# ---- Films ----


def _films(run: Run, folder: Path) -> tuple[list[Medium], str]:
    """Renders a film of each task's example robot, unless the folder has it.

    Returns:
      Two values: all films of the folder, each with its name as caption, and a sentence about
      missing films.
    """
    missing: list[str] = []
    for task in run.tasks():
        example = example_robots.favourite(run, task)
        if example is None:
            missing.append(f"{TASK_NAMES[task]} has no robot with a brain to film.")
            continue
        condition = Condition(task, example_robots.proposer_of(run, task))
        speed, kind = _FILM_SPEEDS[task], f"{example.kind}_{condition.proposer}_{example.robot}"
        path = folder / f"{task}_{kind}_after_training_x{speed:g}.mp4"
        if path in _kept(folder):
            continue
        existed = folder.is_dir()
        folder.mkdir(exist_ok=True)
        try:
            episode = StoredRobot(run, condition, example.robot, "post", SEED).episode()
            films.film(episode, path, seconds=_FILM_SECONDS, speed=speed)
        except InputError as error:
            if not existed:
                folder.rmdir()
            missing.append(f"{TASK_NAMES[task]} has no film: {error}.")
    named = [(path, path.stem.replace("_", " ")) for path in _kept(folder)]
    return [Medium(p, "", name, f"Film: {name}") for p, name in named], " ".join(missing)


def _kept(folder: Path) -> list[Path]:
    """Returns the films of a folder; a link could lead to any file of the reader's."""
    found = (path for path in folder.glob("*.mp4") if not path.name.startswith("."))
    return sorted(path for path in found if path.is_file() and not path.is_symlink())
