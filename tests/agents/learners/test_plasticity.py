"""Each ingredient against the loss of plasticity changes what its source says, and nothing else."""

import numpy as np
import pytest

from musebot.controller.senses import Senses, Signal
from musebot.protocols.agents.factory import factory_of

SENSES = Senses((Signal(0, 1), Signal(-1, 0)), Signal(0, 1))
ROBOTS, STEPS = 200, 30


def lived(name, steps=STEPS, robots=ROBOTS, **settings):
    """Returns a learner after some steps on a fixed stream, in which it never explores."""
    agent, random = factory_of(name)(robots, SENSES, 1, epsilon=0.0, **settings), rewards(steps)
    agent.reset()
    for reward, smell in zip(random, random[::-1], strict=True):
        agent.act(np.tile([smell, -smell], (robots, 1)).astype(np.float32), True)
        agent.learn(np.full(robots, reward, np.float32))
    return agent


def rewards(steps):
    return np.random.default_rng(2).uniform(size=steps).astype(np.float32)


def weights(agent):
    return np.concatenate([w.reshape(len(w), -1) for w in agent.weights().values()], axis=1)


def test_l2_takes_a_share_of_the_weights_and_noise_adds_a_spread_of_its_size():
    # Nothing is learned where the rate is 0: what is left is the ingredient.
    first, last = (weights(lived("q_l2", n, rate=0.0, decay=0.01)) for n in (1, STEPS))
    assert last == pytest.approx(first * 0.99 ** (STEPS - 1), rel=1e-4)
    noisy = weights(lived("q_shrink_perturb", rate=0.0, decay=0.01, noise=0.05))
    left = 0.99 ** (2 * np.arange(STEPS - 1))
    assert (noisy - last).std() == pytest.approx(0.05 * np.sqrt(left.sum()), rel=0.02)


def test_a_mean_reward_of_pace_0_changes_nothing_and_a_constant_reward_is_centred_away():
    assert np.array_equal(weights(lived("q_centred", pace=0.0)), weights(lived("q_learner")))
    agent = factory_of("q_centred")(2, SENSES, 1, epsilon=0.0, pace=1.0)
    agent.reset()
    for _ in range(5000):
        agent.act(np.tile(np.float32([0.5, -0.5]), (2, 1)), True)
        agent.learn(np.full(2, 7.0, np.float32))
    # Values and mean share the constant: mean + (1 - discount) value = reward, Naik's equation.
    value = agent.weights()["output_biases"].max()
    assert 3 < agent.state()["mean"][0] < 7 and value < 7 / (1 - 0.9) / 2


def test_continual_backprop_replaces_the_least_useful_mature_neurons_at_its_rate(monkeypatch):
    agent = lived("q_continual", replaced=0.0)
    monkeypatch.setattr(type(agent), "MATURE", 10)
    agent = lived("q_continual", rate=0.0, replaced=0.01)
    ages = agent.state()["ages"]
    # After 10 steps all 16 are mature; a replaced one is not, so that the share falls slowly.
    due, mature, born = 0.0, 0, []
    for step in range(1, STEPS):
        mature = 16 - sum(step - one <= 10 for one in [0] * (16 - len(born)) + born)
        due += 0.01 * mature
        if due >= 1 - 1e-6:
            due -= 1
            born.append(step)
    assert len(born) > 1 and (np.sort(ages, axis=1)[:, : len(born)] < STEPS - 11).all()
    assert (np.sort(ages, axis=1)[:, len(born) :] == STEPS - 1).all()
    fresh = ages < STEPS - 1
    assert (np.moveaxis(agent.weights()["output_weights"], 1, 2)[fresh] == 0).all()
    assert not np.array_equal(ages[0], ages[1])  # which one depends on its use
