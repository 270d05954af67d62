"""Stable-Baselines3 trains on the batch of robots."""

import numpy as np
import pytest

gymnasium = pytest.importorskip("gymnasium", reason="needs the extra `gym`")
pytest.importorskip("stable_baselines3", reason="needs the extra `baselines`")

from stable_baselines3.common.monitor import Monitor  # noqa: E402
from stable_baselines3.common.vec_env import VecMonitor  # noqa: E402

from musebot.tasks.gymnasium_env import INFO, ArenaVectorEnv  # noqa: E402
from musebot.tasks.stable_baselines import ArenaVecEnv  # noqa: E402

TASK = "wall_avoidance_obstacles"


def test_it_returns_what_gymnasiums_batch_does_and_ends_episodes_in_the_same_step():
    watched = VecMonitor(ArenaVecEnv(TASK, 3, max_episode_steps=4), info_keywords=(*INFO,))
    ours, batch = watched.venv, ArenaVectorEnv(TASK, 3, max_episode_steps=4)
    ours.seed(5)
    first, told = batch.reset(seed=5)
    np.testing.assert_array_equal(watched.reset(), first)
    assert {*ours.reset_infos[0]} == {*INFO}
    for name in INFO:
        np.testing.assert_array_equal([info[name] for info in ours.reset_infos], told[name])
    for step in range(1, 5):
        actions = np.full((3, 2), 0.1 * step, np.float32)
        observations, rewards, ends, infos = watched.step(actions)
        last, their_rewards, _, truncations, told = batch.step(actions)
        np.testing.assert_array_equal(rewards, their_rewards.astype(np.float32))
        np.testing.assert_array_equal(ends, truncations)
        assert ends.all() == (step == 4)
        assert all(info["TimeLimit.truncated"] == (step == 4) for info in infos)
    np.testing.assert_array_equal([info["terminal_observation"] for info in infos], last)
    for name in INFO:
        np.testing.assert_array_equal([info[name] for info in infos], told[name])
    # The batch starts the next episode in its next step.
    np.testing.assert_array_equal(observations, batch.step(actions)[0])
    assert ours.metadata["render_fps"] == 10  # of films


def test_attributes_are_those_of_each_robot():
    ours = ArenaVecEnv(TASK, 3)
    ours.seed(5)
    ours.reset()
    assert [space.shape for space in ours.get_attr("observation_space")] == [(6,)] * 3
    assert len({*ours.get_attr("np_random_seed")}) == 3
    assert ours.get_attr("contact_steps", [1, 2]) == [0, 0]
    assert ours.get_images() == [None] * 3
    assert ours.get_attr("spec")[0] == gymnasium.spec("musebot/WallAvoidanceObstacles-v0")
    with pytest.raises(AttributeError, match="no attributes to set, got 'speed'"):
        ours.set_attr("speed", 1)
    with pytest.raises(AttributeError, match="have no methods, got 'fly'"):
        ours.env_method("fly")
    assert ours.env_is_wrapped(Monitor, [1, 2]) == [False, False]
    assert ours.env_is_wrapped(Monitor) == [False] * 3
    ours.close()
    alive = ArenaVecEnv("life", 2, life="body")
    alive.reset()
    assert alive.get_attr("phase") == [0, 0] and alive.get_attr("spec")[0].id == "musebot/Life-v0"


def test_options_set_for_all_robots_are_obeyed_once():
    place = (0.1, 0.0, 0.3)
    ours, batch = ArenaVecEnv(TASK, 2), ArenaVectorEnv(TASK, 2)
    first = batch.reset(seed=1, options={"robot": place})[0]
    ours.seed(1)
    ours.set_options([{"robot": place}, {"robot": np.array(place)}])
    np.testing.assert_array_equal(ours.reset(), first)
    np.testing.assert_array_equal(ours.reset(), batch.reset()[0])
    for other in ({}, {"robot": np.zeros(3)}, {"spot": place}, None):
        ours.set_options([{"robot": place}, other])
        with pytest.raises(ValueError, match="options must be the same for all robots of a batch"):
            ours.reset()


def test_an_unknown_task_is_refused_with_one_sentence():
    for task in (None, 5, [], "dancing", "musebot/Dancing-v0"):
        with pytest.raises(ValueError, match="task must be .*, got "):
            ArenaVecEnv(task, 2)
