"""Figures of single robots: an example of every kind, before and after training."""

from __future__ import annotations

import dataclasses
import types

import numpy as np
import pytest
import torch
from matplotlib.figure import Figure

from musebot.protocols.analysis.behaviour import Track
from musebot.protocols.lives.cohort import Cohort
from musebot.protocols.lives.conditions import CohortKey, Condition
from musebot.protocols.lives.experiment import Experiment
from musebot.protocols.lives.run import Run, collect
from musebot.protocols.pages import example_robots, robot_figures, style
from musebot.protocols.pages.stored_brains import stored_brains

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


class LeftIsGood:
    """A brain that values the left motor alone, and has two ideas."""

    def __init__(self, offset=0.0):
        self.offset = offset

    def values(self, _, actions):
        return self.offset + actions[..., 0]

    def propose(self, _):
        return torch.tensor([[[-0.3, 0.2], [0.4, -0.1]]])


def above(axis):
    return axis.child_axes[0].get_xlabel()


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


def test_a_path_is_violet_where_the_event_happens_and_begins_at_the_ring():
    poses, events = np.zeros((5, 2, 3)), np.zeros((4, 2), bool)
    poses[:, 1, 0], poses[:, 1, 1], events[2:, 1] = range(5), 7, True
    axis = Figure().subplots()
    robot_figures.draw_path(axis, Track(poses, events, np.zeros(2), np.zeros((4, 2, 2))), 1, "red")
    plain, violet, ring, dot = axis.lines
    assert (plain.get_color(), violet.get_color()) == ("red", style.EVENT)
    np.testing.assert_array_equal(plain.get_xdata(), [0, 1, 2, NAN, NAN])
    np.testing.assert_array_equal(violet.get_xdata(), [NAN, NAN, 2, 3, 4])
    np.testing.assert_array_equal(violet.get_ydata(), [NAN, NAN, 7, 7, 7])
    assert ring.get_markerfacecolor() == "none" != dot.get_markerfacecolor()
    assert (ring.get_xydata().tolist(), dot.get_xydata().tolist()) == ([[0, 7]], [[4, 7]])


def test_each_path_and_share_of_trajectories_is_of_its_robot_and_test(run, monkeypatch):
    asked = []

    def evaluated(run, condition, which, minutes, tick):
        """Robot k is at k / 100, and has an event in k + 1 of 10 steps."""
        asked.extend(which)
        poses = np.zeros((11, 6, 3))
        poses[..., 0] = np.arange(6) / 100
        events = np.arange(10)[:, None] <= np.arange(6)
        return Track(poses, events, np.zeros(2), np.zeros((10, 6, 2)))

    monkeypatch.setattr(robot_figures, "evaluate", evaluated)
    with style.styled():
        axes = robot_figures.trajectories(run, SF).axes
    assert asked == [(row, when) for row in range(3) for when in ("before", "after")]
    assert [axis.get_xlabel().partition(" in ")[0] for axis in axes] == [
        "before: 10%", "before: 30%", "before: 50%", "after: 20%", "after: 40%", "after: 60%"
    ]  # fmt: skip
    places = [axis.lines[-1].get_xdata()[0] for axis in axes]
    assert places == pytest.approx([0.00, 0.02, 0.04, 0.01, 0.03, 0.05])
    titles = [axis.get_title(loc="left") for axis in axes]
    assert titles[:3] == ["ignorant, creative 0", "learner, creative 1", "spoiled, creative 2"]


def test_the_left_motor_is_along_x_and_the_ring_is_around_the_best_idea():
    axis = Figure().subplots()
    robot_figures.draw_values(axis, LeftIsGood(), np.zeros(5))
    (image,) = axis.images
    pixels = image.get_array()
    assert image.origin == "lower" and (np.diff(pixels, axis=1) > 0).all()
    assert (pixels == pixels[0]).all()  # the right motor has no effect
    ideas, *rings = axis.lines
    assert ideas.get_xydata() == pytest.approx(np.array([[-0.3, 0.2], [0.4, -0.1]]))
    assert len(rings) == 2
    for ring in rings:
        assert ring.get_xydata() == pytest.approx(np.array([[0.4, -0.1]]))


def test_values_are_of_the_favourites_brain_before_and_after_training(run, monkeypatch):
    def stored(run, condition, which, seed):
        ((row, when),) = which
        return types.SimpleNamespace(controller=LeftIsGood(10 * row + 5 * (when == "after")))

    monkeypatch.setattr(robot_figures, "stored_brains", stored)
    figure = robot_figures.values(run, WA)
    assert example_robots.favourite(run, WA).row == 1
    assert [above(axis) for axis in figure.axes] == ["9.50 to 10.50"] * 3 + ["14.50 to 15.50"] * 3
    assert figure.axes[0].get_ylabel() == "before training\nright motor"
    assert figure.axes[3].get_ylabel() == "after training\nright motor"
    assert figure.get_suptitle() == "Wall avoidance, learner: creative 1"


def test_the_numbers_are_above_the_image_and_marks_at_its_edge_stay_whole(run):
    condition = Condition(WA, "creative")
    brain = stored_brains(run, condition, [(1, "after")], seed=0).controller
    brain.values = lambda _, actions: -0.002 * (actions[..., 0] + 0.5)
    with style.styled():
        figure = Figure()
        axis = figure.subplots()
        robot_figures.draw_values(axis, brain, np.zeros(5, np.float32))
    assert not axis.texts
    assert above(axis) == "0.00 to 0.00"
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
