"""What holds for every online learner: the interface, checkpoints, tests without exploration."""

import numpy as np
import pytest

from musebot.controller.senses import Senses, Signal
from musebot.protocols.agents.factory import factory_of
from musebot.protocols.agents.settings import settings_of

LEARNERS = ("q_learner", "sarsa_lambda", "stream_q", "stream_ac", "avg", "amortised_q", "dqn")
SENSES = Senses((Signal(0, 1), Signal(-1, 0)), Signal(0, 1))
pytestmark = pytest.mark.parametrize("name", LEARNERS)


def made(name, robots=3, seed=1, **settings):
    return factory_of(name)(robots, SENSES, seed, **settings)


def lived(agent, steps, robots=3, learning=True, seed=0, start=0):
    """Lets an agent live on a fixed stream; returns its actions."""
    random = np.random.default_rng(seed)
    states = random.uniform((0, -1), (1, 0), size=(100, robots, 2)).astype(np.float32)
    rewards = random.uniform(size=(100, robots)).astype(np.float32)
    motors, which = [], slice(start, start + steps)
    for state, reward in zip(states[which], rewards[which], strict=True):
        motors.append(agent.act(state, learning))
        if learning:
            agent.learn(reward)
    return np.array(motors)


def test_motors_lie_within_their_limits(name):
    agent = made(name)
    agent.reset()
    motors = lived(agent, 80)
    assert motors.shape == (80, 3, 2) and np.abs(motors).max() <= 0.5
    assert motors.std() > 0


def test_a_restored_state_continues_bit_exactly(name):
    whole, first, second = (made(name, seed=seed) for seed in (1, 1, 2))
    whole.reset(), first.reset()
    motors = lived(whole, 60)
    lived(first, 30)
    second.load_state({name: array.copy() for name, array in first.state().items()})
    assert np.array_equal(lived(second, 30, start=30), motors[30:])
    np.testing.assert_equal(second.state(), whole.state())


def test_a_test_changes_no_weights_and_what_it_chooses_depends_on_the_state_alone(name):
    agent = made(name)
    agent.reset()
    lived(agent, 40)
    before = {name: weights.copy() for name, weights in agent.weights().items()}
    first = lived(agent, 20, learning=False, seed=5)
    second = lived(agent, 20, learning=False, seed=5)
    np.testing.assert_equal(agent.weights(), before)
    if name != "amortised_q":  # its candidates are drawn anew
        assert np.array_equal(first, second)


def normalised(agent):
    """Returns the signals as the networks receive them, shape (3, 2)."""
    return agent.now.get("features", agent.now["inputs"])[:, :2].numpy().copy()


def test_a_signal_that_first_varies_in_a_test_stays_within_the_bound_of_training(name):
    agent = made(name)
    agent.reset()
    silent = np.full((3, 2), (0.5, 0.0), np.float32)
    for _ in range(50):
        agent.act(silent, True)
        agent.learn(np.zeros(3, np.float32))
    assert np.isfinite(agent.act(np.full((3, 2), (0.5, -1.0), np.float32), False)).all()
    assert np.abs(normalised(agent)).max() <= np.sqrt(51) + 1e-3


def test_a_newborn_chooses_by_what_it_senses_before_anything_is_learned(name):
    states = np.random.default_rng(8).uniform((0, -1), (1, 0), (20, 3, 2)).astype(np.float32)
    agent = made(name)
    agent.reset()
    inputs = []
    for state in states:
        agent.act(state, False)
        inputs.append(normalised(agent))
    assert np.std(inputs, axis=0).min() > 0.1


def test_training_changes_weights_but_not_across_a_placement(name):
    found = []
    for reward in (0, 1):
        agent = made(name)
        agent.reset()
        lived(agent, 20)
        agent.reset()
        before = {name: weights.copy() for name, weights in agent.weights().items()}
        agent.act(np.full((3, 2), (0.4, -0.2), np.float32), True)
        agent.learn(np.full(3, reward, np.float32))
        found.append({name: weights.copy() for name, weights in agent.weights().items()})
        np.testing.assert_equal(
            *({k: w[k] for k in w if "signals" not in k} for w in (before, found[-1]))
        )
        lived(agent, 3, seed=3)
        assert any(not np.array_equal(agent.weights()[k], w) for k, w in before.items())
    np.testing.assert_equal(*found)


def test_a_newborn_that_takes_over_weights_acts_as_the_learner_does_in_a_test(name):
    if name == "amortised_q":
        pytest.skip("its candidates are drawn anew")
    agent, other = made(name), made(name, robots=2, seed=9)
    agent.reset()
    lived(agent, 60)
    other.load_weights({k: w[1:] for k, w in agent.weights().items()})
    agent.reset(), other.reset()
    states = np.random.default_rng(7).uniform((0, -1), (1, 0), (20, 3, 2)).astype(np.float32)
    for state in states:
        np.testing.assert_allclose(
            other.act(state[1:], False), agent.act(state, False)[1:], rtol=0, atol=1e-6
        )


def test_weights_of_another_shape_are_refused(name):
    agent = made(name)
    with pytest.raises(ValueError, match="must have shape"):
        agent.load_weights({k: w[1:] for k, w in made(name).weights().items()})


def test_robots_share_no_weights(name):
    """Another robot's stream changes nothing of this robot's but its random numbers."""
    agents = [made(name) for _ in range(2)]
    random = np.random.default_rng(0)
    for agent in agents:
        agent.reset()
    for _ in range(30):
        state = random.uniform((0, -1), (1, 0), size=(3, 2)).astype(np.float32)
        reward = random.uniform(size=3).astype(np.float32)
        for other, agent in enumerate(agents):
            own_state, own_reward = state.copy(), reward.copy()
            own_state[1:] *= 1 - 0.5 * other
            own_reward[1:] *= 1 - 0.5 * other
            agent.act(own_state, True)
            agent.learn(own_reward)
    for weights, others in zip(*(agent.weights().values() for agent in agents), strict=True):
        np.testing.assert_allclose(weights[0], others[0], rtol=1e-4, atol=1e-5)


def each_of(name):
    return {word: one for word, one in settings_of(factory_of(name)).items() if one.each}


def test_settings_may_be_given_for_each_robot(name):
    """A value for each robot, all equal, is one value; another robot's value changes nothing."""
    one = {word: setting.at(0.4) for word, setting in each_of(name).items()}
    if "epsilon_steps" in one:
        one["epsilon_steps"] = 1.0  # in so few steps the other settings would change nothing
    all_equal = {word: np.full(3, value) for word, value in one.items()}
    agents = [made(name, **settings) for settings in (one, all_equal)]
    for agent in agents:
        agent.reset()
        lived(agent, 40)
    for weights, others in zip(*(agent.weights().values() for agent in agents), strict=True):
        np.testing.assert_allclose(weights, others, rtol=1e-4, atol=1e-5)
    for word, setting in each_of(name).items():
        values = all_equal[word].copy()
        values[1] = setting.at(1.0)
        agent = made(name, **all_equal | {word: values})
        agent.reset()
        lived(agent, 40)
        changed = []
        for key, weights in agent.weights().items():
            np.testing.assert_allclose(
                weights[[0, 2]], agents[1].weights()[key][[0, 2]], rtol=1e-4, atol=1e-5
            )
            changed.append(not np.array_equal(weights[1], agents[1].weights()[key][1]))
        assert any(changed), f"{word} changes nothing"


def test_weights_have_a_row_a_robot_and_seeds_decide_them(name):
    same, equal, other = made(name, seed=1), made(name, seed=1), made(name, seed=2)
    assert {len(weights) for weights in same.weights().values()} == {3}
    np.testing.assert_equal(same.weights(), equal.weights())
    assert any(not np.array_equal(w, other.weights()[k]) for k, w in same.weights().items())


@pytest.mark.parametrize("share", [0.0, 1.0])
def test_both_ends_of_every_setting_stay_stable_on_signals_that_last(name, share):
    settings = settings_of(factory_of(name))
    chosen = {word: one.at(share) for word, one in settings.items() if one.tuned}
    if "epsilon_steps" in chosen:
        chosen["epsilon_steps"] = 1.0  # random actions would hide what diverges
    agent, random = made(name, **chosen), np.random.default_rng(2)
    agent.reset()
    for _ in range(60):
        smell = random.uniform(size=3).astype(np.float32)
        state = np.stack([smell, -smell], axis=1)
        for _ in range(int(random.integers(5, 60))):
            agent.act(state, True)
            agent.learn(smell)
    learned = [w for k, w in agent.weights().items() if "signals" not in k]  # no moments
    largest = max(np.abs(weights).max() for weights in learned)
    assert np.isfinite(largest) and largest < 1000


def test_a_robot_with_broken_weights_harms_no_other(name):
    agent = made(name)
    agent.reset()
    lived(agent, 10)
    state = {key: array.copy() for key, array in agent.state().items()}
    for key in agent.weights():
        state[key][1] = np.nan
    agent.load_state(state)
    lived(agent, 20, start=10)
    for weights in agent.weights().values():
        assert np.isfinite(weights[[0, 2]]).all() and not np.isfinite(weights[1]).all()


def test_nothing_is_left_of_the_past_when_a_robot_is_placed_anew(name):
    agent = made(name)
    agent.reset()
    lived(agent, 20)
    agent.reset()
    traces = {key: array for key, array in agent.state().items() if "trace" in key}
    wanted = {"sarsa_lambda": 1, "stream_q": 2, "stream_ac": 3}  # with the trace of rewards
    assert len(traces) == wanted.get(name, 0)
    assert not any(array.any() for array in traces.values())


@pytest.mark.parametrize("share", [0.0, 1.0])
def test_both_ends_of_every_setting_can_be_simulated(name, share):
    settings = settings_of(factory_of(name))
    agent = made(name, **{word: setting.at(share) for word, setting in settings.items()})
    agent.reset()
    assert np.isfinite(lived(agent, 30)).all()
    assert all(setting.says for setting in settings.values())


# Of the highest reward, 1: a little below what 20 robots with the default settings reach.
LEARNED = {
    "q_learner": 0.8, "sarsa_lambda": 0.8, "stream_q": 0.5, "stream_ac": 0.95, "avg": 0.7,
    "amortised_q": 0.95, "dqn": 0.95,
}  # fmt: skip


def test_the_action_with_the_highest_reward_is_learned(name):
    agent = made(name, robots=20)
    state = np.tile(np.array([0.8, -0.4], np.float32), (20, 1))
    agent.reset()
    motors = agent.act(state, True)
    early = motors.sum(axis=1).mean()
    for step in range(3000):
        paid = motors.sum(axis=1).astype(np.float32)  # straight on, at full speed
        # States vary a little, so that running moments of signals are defined.
        near = state * np.float32(1 + 0.1 * np.sin(step))
        motors = agent.act(near, True)
        agent.learn(paid)
    learned = agent.act(state, False).sum(axis=1).mean()
    assert learned > LEARNED[name] > max(early, 0) + 0.3
