"""Episodes that a policy drives."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

from musebot.protocols.errors import InputError
from musebot.protocols.pages.episode import Episode, check_phase, check_seed
from musebot.tasks.suite import TASKS


@pytest.mark.parametrize("task", TASKS)
def test_episode_is_the_one_that_gymnasium_starts_with_the_same_seed(newborn, task):
    gymnasium_env = pytest.importorskip("musebot.tasks.gymnasium_env")
    policies = newborn(task)
    steps = 2 * (TASKS[task].spot_steps or 15) + 5
    episode = Episode.of_policy(policies, 1, "post", seed=3)
    moments = list(itertools.islice(episode.moments(), steps))
    robots = gymnasium_env.ArenaVectorEnv(task, 1)
    state, _ = robots.reset(seed=3)
    for moment in moments:
        sensed = episode.batch.rules.state(moment.sensordata).astype(np.float32)
        np.testing.assert_array_equal(sensed, state[0])
        np.testing.assert_array_equal(moment.pose, robots._batch.pose[0])
        np.testing.assert_array_equal(moment.spot, robots._batch.spot[0])
        motors = policies.one(1).act(state)
        np.testing.assert_array_equal(moment.motors, motors[0])
        state, *_ = robots.step(motors * 2 * TASKS[task].limit)
    spots = len(np.unique([moment.spot for moment in moments], axis=0))
    assert spots == (3 if TASKS[task].spot_steps else 1)


def test_episode_lasts_as_long_as_that_of_the_task(newborn):
    episode = Episode.of_policy(newborn("spot_finding_unit"), 0, "post", 0)
    times = [moment.time for moment in episode.moments()]
    np.testing.assert_allclose(times, 0.1 * np.arange(1001))
    assert Episode.of_policy(newborn("spot_finding"), 0, "post", 0).seconds == float("inf")


def test_policy_drives_as_before_or_as_after_training(newborn):
    policies = newborn("spot_finding_walls")
    for phase, trained in (("pre", False), ("post", True)):
        episode = Episode.of_policy(policies, 0, phase, 0)
        moment = next(episode.moments())
        state = episode.batch.rules.state(moment.sensordata[None]).astype(np.float32)
        np.testing.assert_array_equal(moment.motors, policies.one(0).act(state, trained)[0])
        assert episode.trained == trained


def test_unknown_phase_and_negative_seed_are_refused():
    with pytest.raises(InputError, match="the phase must be one of pre, post, got 'training'"):
        check_phase("training")
    with pytest.raises(InputError, match="the seed must lie in"):
        check_seed(-1)
    check_phase("pre")
    check_seed(0)
