"""Typical robots: measured numbers choose them, and the figure says which."""

import numpy as np
import pytest

from musebot.protocols.analysis.behaviour import Stay, Track
from musebot.protocols.experiment.conditions import CohortKey, Condition
from musebot.protocols.experiment.experiment import Experiment
from musebot.protocols.playback import measured_behaviour
from musebot.protocols.reporting import style, typical_robots
from musebot.protocols.results.results import collect
from musebot.protocols.results.run import Run
from musebot.protocols.simulation.cohort import Cohort

EXPERIMENT = Experiment(body="kinematic", time_scale=0.02, cohort_size=20, seed=3)


@pytest.fixture(scope="module")
def run():
    lives = []
    for condition in (Condition("wall_avoidance", "fixed"), Condition("spot_finding", "creative")):
        key = CohortKey(condition, 0)
        cohort = Cohort(EXPERIMENT, key)
        cohort.advance(cohort.steps)
        lives.append((key, cohort.lives()))
    return Run("run", EXPERIMENT, collect(EXPERIMENT, lives))


def test_each_typical_robot_is_the_one_that_its_words_describe(run):
    calls = []
    found = {one.kind: one for one in typical_robots.typical_robots(run, lambda: calls.append(1))}
    assert {"spinner", "slow approacher"} <= found.keys()
    assert len(calls) == typical_robots.ticks(run)
    spinner = found["spinner"]
    front = spinner.track.poses[:, spinner.index, :2]
    radius = np.linalg.norm(front - front.mean(axis=0), axis=1)
    assert radius.max() < 0.0275 + 0.02  # a spinner's front moves on a circle
    slow = found["slow approacher"]
    inside = slow.track.events[:, slow.index]
    assert slow.words == f"reaches the spot after\n{inside.argmax() / 600:.3g} minutes"
    arrivals = slow.track.events.argmax(axis=0)[slow.track.events.any(axis=0)] / 600
    wanted = typical_robots.SLOW * EXPERIMENT.time_scale
    nearest = np.abs(arrivals[arrivals > 0] - wanted).min()
    assert abs(inside.argmax() / 600 - wanted) == pytest.approx(nearest)


def test_a_run_whose_robots_hardly_spin_has_no_spinner(run, monkeypatch):
    def spinning(poses):
        seconds = np.zeros((20, poses.shape[1]), bool)
        seconds[:1, 4] = True  # 5 % of the time
        return seconds

    monkeypatch.setattr(typical_robots, "spins", spinning)
    assert "spinner" not in {one.kind for one in typical_robots.typical_robots(run)}
    only = {c: part for c, part in run.results.items() if c.task == "wall_avoidance"}
    assert typical_robots.draw(Run("run", EXPERIMENT, only)) is None


def test_the_follower_is_the_robot_that_its_words_describe(run, monkeypatch):
    """The first robot of three does not stay; the last one follows most."""
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
    steps = round(typical_robots.DRAWN_MINUTES * 600 * EXPERIMENT.time_scale)
    assert follower.drawn == (14, 14 + steps) and steps == 36  # the 30 steps at the rim are in it
    assert follower.words == "follows the rim 80%,\nat last spins 40%"


def test_the_figure_names_kind_proposer_and_robot(run):
    with style.styled():
        figure = typical_robots.draw(run)
    titles = [axis.get_title(loc="left") for axis in figure.axes]
    assert any(title.startswith("spinner\nfixed ") for title in titles)
    assert any(title.startswith("slow approacher\ncreative ") for title in titles)


def test_a_run_without_brains_has_no_typical_robots(run):
    assert typical_robots.draw(Run("empty", EXPERIMENT, {})) is None
    assert typical_robots.ticks(Run("empty", EXPERIMENT, {})) == 0
