"""The study of brains at nine times of their training in spot finding, with frozen weights."""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any, ClassVar

import numpy as np
import torch
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from ....models import Kinematics
from ...errors import InputError
from ...experiment.budget import check_memory
from ...experiment.experiment import Body, Experiment
from ...experiment.overrides import named_brain, named_reading, with_overrides
from ...experiment.plan import Plan
from ...reporting import style
from ...reporting.labels import durations
from ...reporting.markdown import mean_cell, table
from ...reporting.robot_figures import draw_values
from ...shared_options import KinematicsOption, option
from ...simulation.jobs import Job
from ...storage import load_arrays
from ..study import Page, Study, check_positive
from .frozen_brains import (
    CONDITION,
    SEEDS,
    SMELLS,
    Evaluation,
    FrozenTest,
    StoredLifeJob,
    evaluation,
    smells,
    times,
)

SHOWN = (0, 2, 4, 8)  # times in the figure of values


@dataclasses.dataclass
class LearningProgress(Study):
    """Evaluate frozen brains at nine times of their training in spot finding.

    Simulates a cohort of creative robots with each brain. The brains at the beginning and at eight
    times of the training repeat the test after training twice. The page also reports the regret of
    the brains' ideas at four smells.
    """

    name: ClassVar[str] = "learning-progress"

    brains: Annotated[tuple[str, ...], option("BRAIN ..", "paper steady")] = ("paper", "steady")
    """one to four named brains"""
    robots: int = 20
    """number of robots with each brain, in one cohort"""
    seed: int = 1
    """seed from which all random streams derive"""
    reading: Annotated[str | None, option("{body,plain}", "body")] = None
    """sets body, kinematics, form of Eq. 3 and place of the nose; excludes --body, --kinematics"""
    body: Body = "mujoco"
    """body of the robot; kinematic: the kinematic simulator"""
    kinematics: KinematicsOption = ()
    """parameters of the kinematic simulator, such as lag=0.08"""
    time_scale: float = 1.0
    """factor on every duration, in (0, 1]; below 1 for rehearsals"""

    def experiments(self) -> Mapping[str, Experiment]:
        """See `Study.experiments`."""
        if not 1 <= len(self.brains) <= 4 or len({*self.brains}) < len(self.brains):
            raise InputError(f"brains must be 1 to 4 different ones, got {' '.join(self.brains)}")
        check_positive(robots=self.robots)
        world: Mapping[str, Any]
        if self.reading is None:
            world = {
                "body": self.body,
                "kinematics": with_overrides(Kinematics(), self.kinematics),
            }
        elif self.body != "mujoco" or self.kinematics:
            raise InputError("a reading sets body and kinematics; give either it or them")
        else:
            world = named_reading(self.reading)
        shared = Experiment(
            seed=self.seed, cohort_size=self.robots, time_scale=self.time_scale, **world
        )
        found = {n: dataclasses.replace(shared, brain=named_brain(n)) for n in self.brains}
        for experiment in found.values():
            check_memory(Plan.of(experiment, [CONDITION], self.robots))
        return found

    def details(self) -> Mapping[str, Any]:
        """See `Study.details`: the control steps at which networks are stored."""
        return {"times": times(next(iter(self.experiments().values())))}

    def check(self, out: Path) -> None:
        """See `Study.check`."""
        for life in self.lives(out):
            life.restored()
            for test in (FrozenTest(life, seed).path for seed in SEEDS):
                if test.exists():
                    load_arrays(test)

    def lives(self, out: Path) -> list[StoredLifeJob]:
        """Returns the jobs of the first stage, which train the brains."""
        return [StoredLifeJob(out, *named) for named in self.experiments().items()]

    def stages(self, out: Path) -> Iterator[Sequence[Job]]:
        """See `Study.stages`: the jobs that train brains, then the tests of the stored brains."""
        lives = self.lives(out)
        yield lives
        yield [FrozenTest(life, seed) for life, seed in itertools.product(lives, SEEDS)]

    def page(self, out: Path) -> Page:
        """See `Study.page`."""
        found = [evaluation(life) for life in self.lives(out)]
        with style.styled():
            figures = {self.name: draw(found)}
            figures |= {f"values-{one.progress.name}": draw_brain(one) for one in found}
        return Page(markdown(found), figures)


def markdown(found: Sequence[Evaluation]) -> str:
    """Returns the page: a row for each brain, with its test results and the regret of its ideas."""
    head = ["brain", "robots", "in the spot, at its best time", "in the end", "forgotten"]
    head += [f"regret, {smell}" for smell in SMELLS]
    rows = [head]
    for one in found:
        sound = ~np.isnan(one.tests).any(axis=(0, 1))
        best, end = one.best[-1][sound], one.shares[-1][sound]
        cells = [mean_cell(values) for values in (best, end, best - end)]
        shares = [f"{share:.0%}" for share in one.regret[-1].mean(axis=-1)]
        left_out = one.progress.experiment.cohort_size - sound.sum()
        robots = f"{sound.sum()}" + (f" (and {left_out} invalid)" if left_out else "")
        name = f"{one.progress.name}{durations(one.progress.experiment)}"
        rows.append([name, robots, *cells, *shares])
    note = (
        "Shares of the time in the spot, in the test after training with frozen weights. One test "
        "chooses each robot's best time, another gives the shares at that time and in the end: a "
        "robot that was best in the end has forgotten nothing. In brackets 95 % intervals, BCa "
        "bootstrap over robots; none where all are alike. Regret, in the end: value of the best "
        "action minus value of the best idea, as a share of the range of all actions' values."
    )
    return "\n".join([*table(rows), "", note, ""])


def draw(found: Sequence[Evaluation]) -> Figure:
    """Draws a column for each brain: test results by hour, and spread and regret of the ideas."""
    figure, axes = style.canvas(6.0, 3, len(found), sharex=True, sharey="row")
    for column, one in enumerate(found):
        above, middle, below = axes[:, column]
        hours = one.progress.hours
        above.set_title(one.progress.name)
        _line(above, hours, one.best, style.INK, "at its best time so far")
        above.lines[-1].set_linestyle("--")
        _line(above, hours, one.shares, style.colour("creative"), "now")
        for smell, (name, shade) in enumerate(zip(SMELLS, style.PALETTE, strict=False)):
            _line(middle, hours, one.spread[:, smell], shade, name)
            _line(below, hours, one.regret[:, smell], shade, name)
        below.set_xlabel("hours of training")
    labels = ("in the spot,\nfrozen weights", "spread of ideas", "regret of ideas")
    for axis, label in zip(axes[:, 0], labels, strict=True):
        axis.set_ylabel(label)
    for row, top in enumerate((1, None, None)):
        axes[row, 0].set_ylim(0, top)
    for row in (0, 2):
        style.in_per_cent(axes[row, 0].yaxis)
    for row in (0, 1):
        axes[row, -1].legend(frameon=False, fontsize=8)
    return figure


def _line(axis: Axes, hours: np.ndarray, values: np.ndarray, shade: str, label: str) -> None:
    axis.plot(hours, np.nanmean(values, axis=1), color=shade, label=label)


@torch.inference_mode()
def draw_brain(one: Evaluation) -> Figure:
    """Draws the median robot's values of all actions at four times and four smells."""
    middle = np.nanmedian(one.shares[-1])
    robot = int(np.nanargmin(np.abs(one.shares[-1] - middle)))
    states = smells(one.progress.experiment)
    figure, axes = style.canvas(6.0, len(SHOWN), len(SMELLS), sharex=True, sharey=True)
    for row, time in enumerate(SHOWN):
        brain = one.progress.brains(np.array([[time], [robot]])).controller
        for axis, state in zip(axes[row], states, strict=True):
            draw_values(axis, brain, state)
        axes[row, 0].set_ylabel(f"{one.progress.hours[time]:.3g} h\nright motor")
    for axis, name in zip(axes[0], SMELLS, strict=True):
        axis.set_title(name.replace(": ", "\n"))
    figure.supxlabel("left motor", fontsize=9, color=style.INK)
    return figure
