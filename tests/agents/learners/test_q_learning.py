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
