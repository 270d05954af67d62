"""Figures of single robots: an example of every kind, before and after training."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from matplotlib.figure import Figure

from musebot.protocols.experiment.conditions import CohortKey, Condition
from musebot.protocols.experiment.experiment import Experiment
from musebot.protocols.playback.stored_brains import stored_brains
from musebot.protocols.reporting import example_robots, robot_figures, style
from musebot.protocols.results.results import collect
from musebot.protocols.results.run import Run
from musebot.protocols.simulation.cohort import Cohort

WA, SF = "wall_avoidance", "spot_finding"
EXPERIMENT = Experiment(time_scale=0.002, cohort_size=4)
NAN = float("nan")
INVALID = ("invalid", 1, 1, NAN)
KINDS = {
    WA: [("genius", 0, 0, NAN), ("L = 1", 9, 0, 1.0), ("L < 0", 1, 3, -0.5), INVALID],
    SF: [("ignorant", 0, 0, NAN), ("0 < L < 1", 1, 3, 0.5), ("L < 0", 3, 1, -0.5), INVALID],
}


@pytest.fixture(scope="module")
def run() -> Run:
    """Simulated robots whose rows are replaced by an example of every kind."""
    lives = []
    for task in (WA, SF):
        key = CohortKey(Condition(task, "creative"), 0)
        cohort = Cohort(EXPERIMENT, key)
        cohort.advance(cohort.steps)
        lives.append((key, cohort.lives()))
    results = {}
    for condition, part in collect(EXPERIMENT, lives).items():
        rows = [
            dataclasses.replace(
                row, category=name, t_pre_s=pre, t_post_s=post, learn_ability=ability
            )
            for row, (name, pre, post, ability) in zip(
                part.robots, KINDS[condition.task], strict=True
            )
        ]
        results[condition] = dataclasses.replace(part, robots=rows)
    return Run("run", EXPERIMENT, results)


def test_examples_cover_every_kind(run):
    kinds = {e.kind: e.robot for e in example_robots.examples(run, WA)}
    assert kinds == {"genius": 0, "learner": 1, "spoiled": 2}
    kinds = {e.kind: e.robot for e in example_robots.examples(run, SF)}
    assert kinds == {"ignorant": 0, "learner": 1, "spoiled": 2}


@pytest.mark.parametrize("task", [WA, SF])
def test_single_robots_are_drawn_before_and_after_training(task, run, check_files, tmp_path):
    with style.styled():
        for draw in (robot_figures.trajectories, robot_figures.values):
            figure = draw(run, task)
            assert isinstance(figure, Figure)
            assert len(figure.axes) == 6
            check_files(style.save(figure, tmp_path, draw.__name__))


def test_the_numbers_are_above_the_image_and_marks_at_its_edge_stay_whole(run):
    condition = Condition(WA, "creative")
    brain = stored_brains(run, condition, [(1, "after")], seed=0).controller
    brain.values = lambda _, actions: -0.002 * (actions[..., 0] + 0.5)
    with style.styled():
        figure = Figure()
        axis = figure.subplots()
        robot_figures.draw_values(axis, brain, np.zeros(5, np.float32))
    assert not axis.texts
    (above,) = axis.child_axes
    assert above.get_xlabel() == "0.00 to 0.00"
    assert max(axis.images[0].get_extent()) == 0.5 < min(axis.get_xlim()[1], axis.get_ylim()[1])
    assert not any(line.get_clip_on() for line in axis.lines) and len(axis.lines) == 3


def test_words_on_gains_are_of_the_examples_that_are_shown():
    assert example_robots.gains(["genius"]) == ""
    assert example_robots.gains(["ignorant", "spoiled"]) == (
        "The spoiled robot lost most between the two tests. "
    )
    assert example_robots.gains(["learner", "spoiled"]) == (
        "The learner gained most, the spoiled robot lost most between the two tests. "
    )


def test_without_valid_robots_there_is_no_figure(run):
    results = {
        condition: dataclasses.replace(
            part, robots=[dataclasses.replace(row, category="invalid") for row in part.robots]
        )
        for condition, part in run.results.items()
    }
    empty = dataclasses.replace(run, results=results)
    assert example_robots.examples(empty, WA) == []
    assert example_robots.favourite(empty, WA) is None
    assert robot_figures.trajectories(empty, WA) is None
    assert robot_figures.values(empty, SF) is None
    assert robot_figures.ticks(empty) == 0


def test_trajectories_tick_as_often_as_announced(run):
    ticks = []
    for task in (WA, SF):
        robot_figures.trajectories(run, task, lambda: ticks.append(1))
    assert len(ticks) == robot_figures.ticks(run) > 0
