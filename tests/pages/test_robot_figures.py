"""Figures of single robots: examples of every kind."""

import dataclasses

import numpy as np
import pytest
import torch
from helpers import run_of_rows
from matplotlib.figure import Figure

from musebot.protocols.analysis.behaviour import Track
from musebot.protocols.pages import robot_figures, style
from musebot.protocols.runs.conditions import Condition
from musebot.protocols.runs.experiment import Experiment
from musebot.protocols.runs.run import Robot
from musebot.tasks import make_batch
from musebot.tasks.lives import LIVES
from musebot.tasks.suite import TASKS

WA, SF = "wall_avoidance", "spot_finding"
NAN = float("nan")
INVALID = ("invalid", 1, 1, NAN)
KINDS = {
    WA: [("genius", 0, 0, NAN), ("L = 1", 9, 0, 1.0), ("L < 0", 1, 3, -0.5), INVALID],
    SF: [("ignorant", 0, 0, NAN), ("0 < L < 1", 1, 3, 0.5), ("L < 0", 3, 1, -0.5), INVALID],
}


def invented(conditions, kinds, **fields):
    """Returns a run of robots of the given kinds, without networks."""
    rows = [
        Robot(condition.life, condition.proposer, 1, 0, k, pre, post, ability, kind)
        for condition in conditions
        for k, (kind, pre, post, ability) in enumerate(kinds[condition.life])
    ]
    size = len(rows) // len(conditions)
    return run_of_rows(
        rows, Experiment(body="kinematic", time_scale=0.1, cohort_size=size, **fields), minutes=99
    )


# ---- Examples ----


@pytest.fixture
def examples():
    return invented(
        [Condition(task, name) for task in (WA, SF) for name in ("fixed", "creative")], KINDS
    )


@pytest.mark.parametrize(("task", "unmeasured"), [(WA, "genius"), (SF, "ignorant")])
def test_examples_are_creative_and_of_every_kind(examples, task, unmeasured):
    found = {one.kind: one.robot for one in robot_figures.examples(examples, task)}
    assert found == {unmeasured: 0, "learner": 1, "spoiled": 2}
    assert robot_figures.favourite(examples, task).kind == "learner"
    assert robot_figures.favourite(examples, task).condition == Condition(task, "creative")


@pytest.mark.parametrize("name", ["fixed", "agents:mine"])
def test_without_valid_robots_or_without_brains_there_is_no_figure(name):
    kinds = KINDS if name == "agents:mine" else {task: [INVALID] for task in KINDS}
    run = invented([Condition(task, name) for task in (WA, SF)], kinds)
    for task in (WA, SF):
        assert robot_figures.examples(run, task) == []
        assert robot_figures.favourite(run, task) is None
        assert robot_figures.trajectories(run, task) is robot_figures.values(run, task) is None


def test_a_path_is_violet_where_the_event_happens_and_begins_at_the_ring():
    poses, events = np.zeros((5, 2, 3)), np.zeros((4, 2), bool)
    poses[:, 1, 0], poses[:, 1, 1], events[[0, 2], 1] = range(5), 7, True
    track = Track(poses, events, np.zeros((2, 2)), np.zeros((4, 2, 2)))
    axis = Figure().subplots()
    robot_figures.draw_path(axis, track, 1, "red")
    plain, violet, ring, dot = axis.lines
    assert (plain.get_color(), violet.get_color()) == ("red", style.EVENT)
    np.testing.assert_array_equal(plain.get_xdata(), [1, 2, NAN, 3, 4, NAN])
    np.testing.assert_array_equal(violet.get_xdata(), [0, 1, NAN, 2, 3, NAN])
    np.testing.assert_array_equal(violet.get_ydata(), [7, 7, NAN, 7, 7, NAN])
    assert ring.get_markerfacecolor() == "none" != dot.get_markerfacecolor()
    assert (ring.get_xydata().tolist(), dot.get_xydata().tolist()) == ([[0, 7]], [[4, 7]])


def test_each_path_and_share_of_trajectories_is_of_its_robot_and_test(examples, monkeypatch):
    def evaluated(run, condition, which, minutes):
        """Robot k and its spot are at k / 100; it has an event in k + 1 of 10 steps."""
        assert which == [(row, when) for row in range(3) for when in ("before", "after")]
        poses = np.zeros((11, 6, 3))
        poses[..., 0] = np.arange(6) / 100
        events = np.arange(10)[:, None] <= np.arange(6)
        return Track(poses, events, poses[0, :, :2], np.zeros((10, 6, 2)))

    monkeypatch.setattr(robot_figures, "evaluate", evaluated)
    with style.styled():
        axes = robot_figures.trajectories(examples, SF).axes
    shown = [(axis.get_xlabel().split("%")[0], axis.lines[-1].get_xdata()[0]) for axis in axes]
    assert shown == [
        *((f"before: {k + 1}0", k / 100) for k in (0, 2, 4)),
        *((f"after: {k + 1}0", k / 100) for k in (1, 3, 5)),
    ]
    assert [axis.patches[1].center[0] for axis in axes] == [line for _, line in shown]
    titles = [axis.get_title(loc="left") for axis in axes]
    assert titles[:3] == ["ignorant, creative 0", "learner, creative 1", "spoiled, creative 2"]


class LeftIsGood:
    """A brain that values the left motor alone, and has two ideas."""

    def __init__(self, offset=0.0, slope=1.0):
        self.offset, self.slope = offset, slope

    def values(self, _, actions):
        return self.offset + self.slope * actions[..., 0]

    def propose(self, _):
        return torch.tensor([[[-0.3, 0.2], [0.4, -0.1]]])


def above(axis):
    return axis.child_axes[0].get_xlabel()


def test_the_left_motor_is_along_x_and_the_ring_is_around_the_best_idea():
    axis = Figure().subplots()
    robot_figures.draw_values(axis, LeftIsGood(-0.001, 0.002), np.zeros(5))
    (image,) = axis.images
    pixels = image.get_array()
    assert image.origin == "lower" and (np.diff(pixels, axis=1) > 0).all()
    assert pixels.shape == (41, 41) and (pixels == pixels[0]).all()  # the right motor: no effect
    assert float(np.ptp(pixels)) == pytest.approx(0.002)  # of motor values from -0.5 to 0.5
    ideas, *rings = axis.lines
    assert ideas.get_xydata() == pytest.approx(np.array([[-0.3, 0.2], [0.4, -0.1]]))
    for ring in rings:
        assert ring.get_xydata() == pytest.approx(np.array([[0.4, -0.1]]))
    assert above(axis) == "0.00 to 0.00"


@pytest.mark.parametrize("name", [WA, "mine"])
def test_values_are_of_the_favourites_brain_before_and_after_training(name, monkeypatch):
    life = dataclasses.replace(LIVES[WA], name="mine", title="My walls")
    run = invented([Condition(name, "creative")], {name: KINDS[WA]}, life=life)

    def stored(run, condition, which):
        ((row, when),) = which
        agent = robot_figures.NeurocontrollerAgent.__new__(robot_figures.NeurocontrollerAgent)
        agent.controller = LeftIsGood(10 * row + 5 * (when == "after"))
        return agent

    monkeypatch.setattr(robot_figures, "stored_brains", stored)
    figure = robot_figures.values(run, name)
    assert [above(axis) for axis in figure.axes] == ["9.50 to 10.50"] * 3 + ["14.50 to 15.50"] * 3
    labels = [axis.get_ylabel().split()[0] for axis in (figure.axes[0], figure.axes[3])]
    assert labels == ["before", "after"]
    title = run.experiment.life_of(name).title
    assert figure.get_suptitle() == f"{title}, learner: creative 1"
    assert figure.axes[2].get_title() == "pressed against it"


def test_situations_match_their_names():
    walls = robot_figures.situations(make_batch(WA, 1))
    front, contact = {k: v[0] for k, v in walls.items()}, {k: v[4] for k, v in walls.items()}
    assert front["a wall 3 cm ahead"] == pytest.approx(1 / 1.03**10, rel=0.02)
    assert front["in the open"] < 0.05
    assert contact == {"in the open": 0, "a wall 3 cm ahead": 0, "pressed against it": -1}
    smells = {k: v[0] for k, v in robot_figures.situations(make_batch(SF, 1)).items()}
    assert smells["no smell"] == 0
    assert smells["spot 20 cm ahead"] == pytest.approx(3 / 4, rel=0.01)  # s' = 10 * 0.06 / 0.2
    assert smells["inside the spot"] == pytest.approx(10 / 11)
    for task in TASKS:
        robot_figures.situations(batch := make_batch(task, 1))
        assert batch.rules.event(batch.sensordata).all(), task
