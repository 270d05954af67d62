"""A small run and a check of figures, for the tests of playback."""

import dataclasses
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from musebot.protocols.pages import style
from musebot.protocols.pages.replay import StoredRobot
from musebot.protocols.runs.conditions import Condition
from musebot.protocols.runs.experiment import Experiment
from musebot.protocols.runs.plan import Plan
from musebot.protocols.runs.run import Run
from musebot.protocols.runs.run_files import read_run
from musebot.protocols.runs.simulation import simulate

CONDITIONS = (
    Condition("wall_avoidance", "fixed"),
    Condition("wall_avoidance", "creative"),
    Condition("spot_finding", "creative"),
)
PLAN = Plan.of(Experiment(time_scale=0.002, cohort_size=3), CONDITIONS, robots=3)


@pytest.fixture(scope="session")
def directory(tmp_path_factory: pytest.TempPathFactory, in_process) -> Path:
    """The folder of a run with three robots in each of three conditions."""
    directory = tmp_path_factory.mktemp("pages") / "run"
    simulate(directory, PLAN, in_process(), quiet=True)
    return directory


@pytest.fixture(scope="session")
def run(directory: Path) -> Run:
    """The run in the folder, with its brains."""
    return read_run(directory, replay=True)


@pytest.fixture(scope="session")
def invalid(run: Run) -> Run:
    """The run with all robots invalid."""
    results = {
        condition: dataclasses.replace(
            part, robots=[dataclasses.replace(row, category="invalid") for row in part.robots]
        )
        for condition, part in run.results.items()
    }
    return dataclasses.replace(run, results=results)


@pytest.fixture(scope="session")
def stored(run: Run) -> Callable[..., StoredRobot]:
    """Makes a stored robot of the run, by default a creative one of wall avoidance after training.

    Changes of `task` and `proposer` choose the condition; others are fields of `StoredRobot`.
    """

    def stored(**changes) -> StoredRobot:
        names = (changes.pop("task", "wall_avoidance"), changes.pop("proposer", "creative"))
        robot = StoredRobot(run, Condition(*names), 0, "post")
        return dataclasses.replace(robot, **changes)

    return stored


@pytest.fixture
def check_figure(tmp_path):
    """Checks that a figure is written as .svg and .png, transparent and not empty."""

    def check(figure):
        style.save(figure, tmp_path, "figure")
        assert "<svg" in (tmp_path / "figure.svg").read_text()
        opaque = np.asarray(Image.open(tmp_path / "figure.png").convert("RGBA"))[..., 3] > 200
        assert 0.005 < opaque.mean() < 0.95

    return check
