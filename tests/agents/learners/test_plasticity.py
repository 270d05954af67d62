"""Each ingredient against the loss of plasticity changes what its source says, and nothing else."""

import numpy as np
import pytest

from musebot.controller.senses import Senses, Signal
from musebot.protocols.agents.factory import factory_of

SENSES = Senses((Signal(0, 1), Signal(-1, 0)), Signal(0, 1))
ROBOTS, STEPS, HIDDEN = 50, 30, 16


def lived(name, steps=STEPS, rewards=None, **settings):
    """Returns a learner after some steps on a fixed stream, in which it never explores.

    `rewards` are those of the steps, or one for all; None: the smell.
    """
    usual = {"epsilon": 0.0, "epsilon_steps": 1.0, "hidden": HIDDEN}
    agent, random = (
        factory_of(name)(ROBOTS, SENSES, 1, **usual | settings),
        np.random.default_rng(2),
    )
    agent.reset()
    smells = random.uniform(size=steps)
    rewards = np.broadcast_to(smells if rewards is None else rewards, steps)
    for smell, reward in zip(smells, rewards, strict=True):
        agent.act(np.tile([smell, -smell], (ROBOTS, 1)).astype(np.float32), True)
        agent.learn(np.full(ROBOTS, reward, np.float32))
    return agent


def weights(agent):
    return np.concatenate([w.reshape(len(w), -1) for w in agent.weights().values()], axis=1)


def test_l2_takes_a_share_of_the_weights_and_noise_adds_a_spread_of_its_size():
    # Nothing is learned where the rate is 0: what is left is the ingredient.
    first, last = (weights(lived("dqn_l2", n, rate=0.0, decay=0.01)) for n in (1, STEPS))
    assert last == pytest.approx(first * 0.99 ** (STEPS - 1), rel=1e-4)
    noisy = weights(lived("dqn_shrink_perturb", rate=0.0, decay=0.01, noise=0.05))
    left = 0.99 ** (2 * np.arange(STEPS - 1))
    assert (noisy - last).std() == pytest.approx(0.05 * np.sqrt(left.sum()), rel=0.02)


def test_rewards_are_less_their_running_mean():
    plain = weights(lived("dqn_no_replay"))
    assert np.array_equal(weights(lived("dqn_centred", pace=0.0)), plain)
    assert not np.array_equal(weights(lived("dqn_centred", pace=0.1)), plain)
    mean = lived("dqn_centred", pace=0.1, rewards=7.0).state()["mean"]
    assert mean == pytest.approx(7 * (1 - 0.9 ** (STEPS - 1)), rel=1e-5)
    # With pace 1 a constant reward is centred away after the first one.
    centred = weights(lived("dqn_centred", 3, pace=1.0, rewards=7.0))
    assert centred == pytest.approx(weights(lived("dqn_no_replay", 3, rewards=[0.0, 7.0, 0.0])))


def test_continual_backprop_replaces_the_least_useful_mature_neurons_at_its_rate(monkeypatch):
    monkeypatch.setattr(type(lived("dqn_continual", 1)), "MATURE", 10)
    agent = lived("dqn_continual", rate=0.0, replaced=0.01)
    born, due = [], 0.0
    for step in range(1, STEPS):  # a replaced neuron is not mature: the share falls
        due += 0.01 * (HIDDEN * (step > 10) - sum(step - one <= 10 for one in born))
        if due >= 1:
            due -= 1
            born.append(step)
    ages = agent.state()["ages"]
    assert len(born) > 1
    wanted = np.sort([STEPS - 1 - one for one in born] + [STEPS - 1] * (HIDDEN - len(born)))
    assert (np.sort(ages, axis=2) == wanted).all()
    outgoing = np.moveaxis(agent.weights()["values.4"], 1, 2)  # of the last hidden layer
    assert (outgoing[ages[1] < STEPS - 1] == 0).all() and outgoing.any(axis=2).sum() > 0
    one = lived("dqn_continual", born[0], rate=0.0, replaced=0.01)
    hidden = one.networks.layers(one.now["inputs"][:, None])[1][:, 0]
    useful = hidden.abs() * one.networks.tensors[2].abs().sum(dim=1)
    utility = 0.99 * one.state()["utility"][0] + 0.01 * useful.numpy()
    ages = lived("dqn_continual", born[0] + 1, rate=0.0, replaced=0.01).state()["ages"][0]
    assert (ages.argmin(axis=1) == utility.argmin(axis=1)).all() and not ages.min()
