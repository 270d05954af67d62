"""A small run, policies with random weights and a check for EGL, for the tests of playback."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest
from PIL import Image

from musebot.protocols.agents import ppo
from musebot.protocols.lives.cohort import Cohort
from musebot.protocols.lives.conditions import Condition
from musebot.protocols.lives.experiment import Experiment
from musebot.protocols.lives.manifest import write_manifest
from musebot.protocols.lives.plan import Plan
from musebot.protocols.lives.run import Measured, Run, joined, results_of
from musebot.protocols.lives.run_files import write_results
from musebot.protocols.pages import style
from musebot.protocols.pages.replay import StoredRobot
from musebot.protocols.storage import save_arrays
from musebot.tasks.suite import TASKS

EXPERIMENT = Experiment(time_scale=0.002, cohort_size=3)
CONDITIONS = (
    Condition("wall_avoidance", "fixed"),
    Condition("wall_avoidance", "creative"),
    Condition("spot_finding", "creative"),
)
PLAN = Plan.of(EXPERIMENT, CONDITIONS, robots=3)


@pytest.fixture(scope="session")
def measured() -> Measured:
    """What was measured of three robots in each of three conditions."""
    lives = []
    for key in PLAN.cohorts():
        cohort = Cohort(EXPERIMENT, key)
        cohort.advance(cohort.steps)
        lives.append((key, cohort.lives()))
    return joined({}, lives)


@pytest.fixture(scope="session")
def run(measured: Measured) -> Run:
    """A run with three robots in each of three conditions."""
    return Run("run", EXPERIMENT, results_of(EXPERIMENT, measured))


@pytest.fixture(scope="session")
def directory(measured: Measured, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of the run."""
    directory = tmp_path_factory.mktemp("run")
    write_manifest(directory, PLAN)
    write_results(directory, EXPERIMENT, measured)
    return directory


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


@pytest.fixture(scope="session")
def newborn() -> Callable[[str], ppo.Policies]:
    """Makes two policies of a task with random weights, which differ before and after training."""

    def newborn(task: str) -> ppo.Policies:
        random = np.random.default_rng(0)
        sensors = sum(n for n, *_ in TASKS[task].rules.shapes.values())
        arrays = {}
        for when in ("before", "after"):
            for layer, (outputs, inputs) in enumerate([(64, sensors), (64, 64), (2, 64)]):
                weights = random.normal(size=(2, outputs, inputs))
                arrays[f"{when}.{layer}.weights"] = weights.astype(np.float32)
                arrays[f"{when}.{layer}.biases"] = random.normal(size=(2, outputs)).astype("f4")
        return ppo.Policies(task, arrays)

    return newborn


@pytest.fixture(scope="session")
def policy_file(newborn: Callable[[str], ppo.Policies]) -> Callable[[str, Path], Path]:
    """Writes policies of a task into a file."""

    def policy_file(task: str, path: Path) -> Path:
        save_arrays(path, newborn(task).arrays, task=task)
        return path

    return policy_file


@pytest.fixture
def check_figure(tmp_path):
    """Checks that a figure is written as .svg and .png, transparent and not empty."""

    def check(figure):
        style.save(figure, tmp_path, "figure")
        assert ElementTree.parse(tmp_path / "figure.svg").getroot().tag.endswith("svg")
        picture = np.asarray(Image.open(tmp_path / "figure.png").convert("RGBA"))
        assert (picture[..., 3] == 0).mean() > 0.05  # the background is transparent
        assert (picture[..., 3] > 200).mean() > 0.005  # and something is drawn

    return check
