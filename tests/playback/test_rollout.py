"""Batches of stored brains, evaluated and recorded."""

from __future__ import annotations

import numpy as np
import pytest

from musebot.protocols.experiment.conditions import Condition
from musebot.protocols.playback import rollout
from musebot.protocols.playback.stored_brains import StoredRobot
from musebot.tasks import make_batch


def test_batch_of_brains_does_what_each_brain_does_alone(run):
    # The fixed proposer has no noise, so that every brain's path is bit-exact.
    condition = Condition("wall_avoidance", "fixed")
    rows = [(0, "before"), (2, "after"), (1, "before")]
    track = rollout.evaluate(run, condition, rows, 0.02)
    for index, (row, when) in enumerate(rows):
        phase = {"before": "pre", "after": "post"}[when]
        alone = StoredRobot(run, condition, row, phase).episode()
        for pose, moment in zip(track.poses[:, index], alone.moments(), strict=False):
            np.testing.assert_allclose(pose, moment.pose, atol=1e-6)


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


@pytest.mark.parametrize(("minutes", "count"), [(0.5, 1), (1.0, 1), (1.1, 2)])
def test_started_minutes_tick_once(minutes, count):
    ticks = []
    steps = round(600 * minutes)
    batch = make_batch("wall_avoidance", 1)
    rollout.watch(batch, Recorder(), steps, learning=False, tick=lambda: ticks.append(1))
    assert len(ticks) == rollout.minutes_of(minutes) == count
