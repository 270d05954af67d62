"""The Q-learner follows Watkins' update, one step at a time."""

import numpy as np
import pytest
import torch

from musebot.controller.senses import Senses, Signal
from musebot.protocols.agents.learners.q_learning import q_learner


def signals(count):
    return Senses((Signal(-1, 1),) * count, Signal(-1, 1))


def learner(robots, count, seed):
    return q_learner(robots, signals(count), seed)


def test_a_step_is_watkins_update_as_autograd_computes_it():
    agent = learner(4, 2, seed=3)
    random = np.random.default_rng(0)
    states = random.normal(size=(3, 4, 2)).astype(np.float32)
    reward = random.normal(size=4).astype(np.float32)
    agent.reset()
    agent.act(states[0], True)
    agent.act(states[1], True)
    before = {k: torch.from_numpy(v.copy()).requires_grad_() for k, v in agent.weights().items()}

    def values(state):
        sums = torch.einsum("bhi,bi->bh", before["hidden_weights"], torch.from_numpy(state))
        hidden = (sums + before["hidden_biases"]).sigmoid()
        return (
            torch.einsum("boh,bh->bo", before["output_weights"], hidden) + before["output_biases"]
        )

    chosen = agent.before["chosen"]
    value = values(states[0])[torch.arange(4), chosen]
    best = values(states[1]).amax(dim=1).detach()
    (0.5 * (torch.from_numpy(reward) + 0.9 * best - value) ** 2).sum().backward()
    agent.learn(reward)
    for name, weights in agent.weights().items():
        assert before[name].grad.abs().max() > 0
        wanted = before[name] - 0.05 * before[name].grad
        assert torch.from_numpy(weights) == pytest.approx(wanted.detach(), abs=1e-6)


def test_the_step_across_a_placement_is_not_learned_from():
    agent = learner(2, 1, seed=0)
    agent.reset()
    agent.act(np.ones((2, 1), np.float32), True)
    agent.act(np.zeros((2, 1), np.float32), True)
    agent.reset()
    agent.act(np.ones((2, 1), np.float32), True)
    before = {name: weights.copy() for name, weights in agent.weights().items()}
    agent.learn(np.ones(2, np.float32))
    assert all(np.array_equal(before[name], w) for name, w in agent.weights().items())
    agent.act(np.zeros((2, 1), np.float32), True)
    agent.learn(np.ones(2, np.float32))
    assert not all(np.array_equal(before[name], w) for name, w in agent.weights().items())


def test_the_action_with_the_highest_reward_is_learned():
    agent = learner(20, 1, seed=1)
    state = np.ones((20, 1), np.float32)
    agent.reset()
    motors = agent.act(state, True)
    for _ in range(3000):
        paid = motors.sum(axis=1).astype(np.float32)  # straight on, at full speed
        motors = agent.act(state, True)
        agent.learn(paid)
    assert agent.act(state, False).mean() > 0.4


def test_a_factory_makes_one_learner_a_robot():
    agent = learner(3, 5, seed=7)
    assert {len(weights) for weights in agent.weights().values()} == {3}
    same, other = learner(3, 5, seed=7), learner(3, 5, seed=8)
    weights = "hidden_weights"
    assert np.array_equal(agent.weights()[weights], same.weights()[weights])
    assert not np.array_equal(agent.weights()[weights], other.weights()[weights])


def test_a_restored_state_continues_bit_exactly():
    random = np.random.default_rng(0)
    states = random.normal(size=(60, 4, 2)).astype(np.float32)
    rewards = random.normal(size=(60, 4)).astype(np.float32)

    def steps(agent, which):
        motors = []
        for step in which:
            motors.append(agent.act(states[step], True))
            agent.learn(rewards[step])
        return motors

    straight, first, second = (learner(4, 2, seed=seed) for seed in (1, 1, 2))
    straight.reset()
    first.reset()
    whole = steps(straight, range(60))
    steps(first, range(30))
    second.load_state({name: array.copy() for name, array in first.state().items()})
    assert np.array_equal(steps(second, range(30, 60)), whole[30:])
    np.testing.assert_equal(second.state(), straight.state())
