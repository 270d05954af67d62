"""Typical robots: measured numbers choose them, and the figure says which."""

import dataclasses

import numpy as np
import pytest

from musebot.protocols.analysis.behaviour import Stay, Track
from musebot.protocols.lives.conditions import Condition
from musebot.protocols.lives.experiment import Experiment
from musebot.protocols.lives.run import ConditionResults, Robot, Run
from musebot.protocols.pages import measured_behaviour, style, typical_robots
from musebot.protocols.pages.rollout import ticks_of

EXPERIMENT = Experiment(body="kinematic", time_scale=0.1, cohort_size=5)
WALLS, SPOT = Condition("wall_avoidance", "fixed"), Condition("spot_finding", "creative")
SPINNING = (0, 6, 9, 3)  # of 12 seconds
ARRIVALS = (0, 600, 1440, 2000)  # steps; 1500 are `SLOW` minutes


def evaluated(run, condition, which, minutes, tick):
    """Returns the track of four robots that spin, or arrive at the spot, as invented."""
    assert which == [(row, "after") for row in (1, 2, 3, 4)]
    for _ in range(ticks_of(minutes)):
        tick()
    steps = round(600 * minutes)
    number = np.arange(steps)[:, None]
    spinning = number < 10 * np.array(SPINNING if condition == WALLS else 4 * [0])
    poses = np.zeros((steps + 1, 4, 3))
    poses[1:, :, 2] = 0.2 * spinning.cumsum(axis=0)
    events = number >= np.array(ARRIVALS)
    return Track(poses, events, np.zeros(2), np.zeros((steps, 4, 2)))


@pytest.fixture
def run(monkeypatch):
    """A run of five robots in each condition, the first of them invalid."""
    monkeypatch.setattr(typical_robots, "evaluate", evaluated)
    results = {}
    for condition, first in ((WALLS, 7), (SPOT, 20)):
        rows = [
            Robot(condition.task, condition.proposer, 1, 0, first + i, 1.0, 2.0, 0.5, kind)
            for i, kind in enumerate(["invalid", *["0 < L < 1"] * 4])
        ]
        results[condition] = ConditionResults(rows, np.zeros((5, 99)), {"before": {}, "after": {}})
    return Run("run", EXPERIMENT, results)


def test_each_typical_robot_is_the_one_that_its_words_describe(run):
    calls = []
    found = {one.kind: one for one in typical_robots.typical_robots(run, lambda: calls.append(1))}
    assert found.keys() == {"spinner", "slow approacher"}
    assert len(calls) == typical_robots.ticks(run)
    spinner, slow = found["spinner"], found["slow approacher"]
    assert (spinner.index, spinner.row, spinner.condition) == (2, 3, WALLS)
    assert spinner.words == "spins in 75% of\nthe first 0.2 minutes"
    front = spinner.track.poses[:, spinner.index, :2]
    assert np.linalg.norm(front, axis=1) == pytest.approx(0.0275)  # it moves on a circle
    assert (slow.index, slow.row, slow.condition) == (2, 3, SPOT)
    assert slow.words == "reaches the spot after\n2.4 minutes"


def test_a_run_whose_robots_hardly_spin_has_no_spinner(run, monkeypatch):
    def spinning(poses):
        seconds = np.zeros((20, poses.shape[1]), bool)
        seconds[:1, 3] = True  # 5 % of the time
        return seconds

    monkeypatch.setattr(typical_robots, "spins", spinning)
    assert "spinner" not in {one.kind for one in typical_robots.typical_robots(run)}
    only = {c: part for c, part in run.results.items() if c.task == "wall_avoidance"}
    assert typical_robots.draw(Run("run", EXPERIMENT, only)) is None


def test_the_follower_is_the_robot_that_its_words_describe(run, monkeypatch):
    """The first robot of three does not stay; the last one follows most."""
    run = dataclasses.replace(run, experiment=dataclasses.replace(EXPERIMENT, time_scale=0.02))
    results = {SPOT: run.results[SPOT]}
    results[SPOT].robots[:] = [dataclasses.replace(r, t_post_s=0.0) for r in results[SPOT].robots]
    run = dataclasses.replace(run, results=results)
    numbers = Stay(
        np.array([False, True, True]),
        np.array([[0.9, 0.9], [0.2, 0.3], [0.8, 0.1]]),
        np.array([[0.9, 0.9], [0.1, 0.3], [0.0, 0.4]]),
        np.zeros((1, 3)),
    )
    nose = np.full((60, 3, 2), 0.2)
    nose[20:50, 2] = 0.06, 0.0  # at the rim
    track = Track(np.zeros((61, 3, 3)), np.zeros((60, 3), bool), np.zeros(2), nose)
    monkeypatch.setattr(measured_behaviour, "finders", lambda *_: [5, 6, 7])
    monkeypatch.setattr(typical_robots, "from_the_rim", lambda *_: (track, 0.06))
    monkeypatch.setattr(typical_robots, "stay_of", lambda *_: numbers)
    found = {one.kind: one for one in typical_robots.typical_robots(run)}
    follower = found["contour follower"]
    assert (follower.row, follower.index, follower.track) == (7, 2, track)
    steps = round(typical_robots.DRAWN_MINUTES * 600 * 0.02)
    assert follower.drawn == (14, 14 + steps) and steps == 36  # the 30 steps at the rim are in it
    assert follower.words == "follows the rim 80%,\nat last spins 40%"


def test_the_figure_names_kind_proposer_robot_and_what_was_measured(run):
    with style.styled():
        axes = typical_robots.draw(run).axes
    assert [axis.get_title(loc="left") for axis in axes] == [
        "spinner\nfixed 10", "slow approacher\ncreative 23"
    ]  # fmt: skip
    assert axes[0].get_xlabel() == "spins in 75% of\nthe first 0.2 minutes"
    assert axes[1].get_xlabel() == "reaches the spot after\n2.4 minutes"


def test_a_run_without_brains_has_no_typical_robots(run):
    assert typical_robots.draw(Run("empty", EXPERIMENT, {})) is None
    assert typical_robots.ticks(Run("empty", EXPERIMENT, {})) == 0
