"""Batches of stored brains, evaluated and recorded."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

from musebot.protocols.lives.conditions import Condition
from musebot.protocols.pages import rollout
from musebot.protocols.pages.stored_brains import StoredRobot
from musebot.tasks import make_batch


def test_batch_of_brains_does_what_each_brain_does_alone(run):
    # The fixed proposer has no noise, so that every brain's path is bit-exact.
    condition = Condition("wall_avoidance", "fixed")
    rows = [(0, "before"), (2, "after"), (1, "before")]
    track = rollout.evaluate(run, condition, rows, 0.02)
    for index, (row, when) in enumerate(rows):
        phase = {"before": "pre", "after": "post"}[when]
        alone = StoredRobot(run, condition, row, phase).episode()
        moments = itertools.islice(alone.moments(), len(track.poses))
        poses = [moment.pose for moment in moments]
        assert len(poses) == 13
        np.testing.assert_array_equal(track.poses[:, index], np.array(poses, dtype=np.float32))


class Recorder:
    """An agent that drives straight on and records its calls."""

    def __init__(self):
        self.calls = []

    def act(self, state, learning):
        self.calls.append(("act", learning))
        return np.full((len(state), 2), 0.1)

    def learn(self, reward):
        self.calls.append(("learn", reward.dtype))


def test_agent_learns_in_every_step_only_where_learning_is_on():
    for learning, calls in (
        (True, [("act", True), ("learn", np.float32)]),
        (False, [("act", False)]),
    ):
        agent = Recorder()
        batch = make_batch("spot_finding", 2)
        track = rollout.watch(batch, agent, 3, learning=learning, tick=lambda: None)
        assert agent.calls == calls * 3
        assert track.poses.shape == (4, 2, 3)
        assert track.events.shape == (3, 2)
        assert track.nose.shape == (3, 2, 2)
        np.testing.assert_allclose(track.poses[-1], batch.pose, atol=1e-6)
        np.testing.assert_array_equal(track.spot, batch.spot[0])


@pytest.mark.parametrize(("learning", "exploring"), [(False, False), (False, True), (True, True)])
def test_events_are_counted_as_a_track_records_them(learning, exploring):
    agent = Recorder()
    batch, again = (make_batch("wall_avoidance", 2) for _ in range(2))
    for robots in (batch, again):  # one of them at a wall
        robots.place(np.arange(2), np.array([[0.49, 0.0, 0.0], [0.0, 0.0, 0.0]]))
    mode = rollout.Mode(exploring=exploring, learning=learning)
    counts = rollout.count_events(batch, agent, 9, tick=lambda: None, mode=mode)
    assert agent.calls == [("act", exploring), *[("learn", np.float32)] * learning] * 9
    track = rollout.watch(again, Recorder(), 9, learning=False, tick=lambda: None)
    np.testing.assert_array_equal(counts, track.events.sum(axis=0))
    assert counts[0] > counts[1] == 0


@pytest.mark.parametrize(("minutes", "count"), [(0.5, 1), (1.0, 1), (1.1, 2)])
def test_started_minutes_tick_once(minutes, count):
    ticks = []
    steps = round(600 * minutes)
    batch = make_batch("wall_avoidance", 1)
    rollout.watch(batch, Recorder(), steps, learning=False, tick=lambda: ticks.append(1))
    assert len(ticks) == rollout.ticks_of(minutes) == count


def test_a_track_has_the_spot_in_the_frame_of_the_nose():
    batch = make_batch("spot_finding", 1)
    batch.place_spot(np.array([0]), np.array([[0.3, 0.2]]))
    batch.place(np.array([0]), np.array([[0.1, -0.1, 0.5]]))
    track = rollout.watch(batch, Recorder(), 3, learning=False, tick=lambda: None)
    x, y, heading = track.poses[-1, 0].astype(float)
    ahead = np.array([np.cos(heading), np.sin(heading)])
    away = np.array([0.3, 0.2]) - [x, y] - batch.dimensions.nose * ahead
    expected = [away @ ahead, away @ [-ahead[1], ahead[0]]]
    np.testing.assert_allclose(track.nose[-1, 0], expected, atol=5e-4)  # sensed a substep before
