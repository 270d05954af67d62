"""The learned proposal distribution, against autograd."""

import math

import pytest
import torch
from helpers import ideas_of
from hypothesis import settings

from musebot.controller import Parameters
from musebot.controller.novelty.proposal_distribution import ProposalDistribution

quick = settings(deadline=None, max_examples=30)

BEST = Parameters(novelty="learned", memory_target="best", activation="tanh")


def distribution(robots=3, seed=0):
    return ProposalDistribution(BEST, robots, 2, torch.Generator().manual_seed(seed))


@pytest.mark.usefixtures("double_precision")
def test_a_step_follows_the_gradient_of_log_density_and_entropy():
    own = distribution()
    random = torch.Generator().manual_seed(1)
    state, action = torch.rand(3, 2, generator=random), torch.rand(3, 2, generator=random) - 0.5
    rates = torch.tensor([0.1, 0.0, 0.3])
    before = {name: tensor.clone() for name, tensor in own.weights().items()}
    leaves = {name: t.clone().requires_grad_() for name, t in before.items()}
    sums = (leaves["hidden_weights"] @ state[..., None])[..., 0] + leaves["hidden_biases"]
    hidden = torch.tanh(sums)[..., None]
    outputs = (leaves["output_weights"] @ hidden)[..., 0] + leaves["output_biases"]
    mean = outputs[:, :2].sigmoid() - 0.5
    spread = 0.05 + 0.45 * outputs[:, 2:].sigmoid()
    normal = torch.distributions.Normal(mean, spread)
    (normal.log_prob(action) + 0.1 * normal.entropy()).sum().backward()
    own.learn(state, action, rates, rate=0.5)
    for name, tensor in own.weights().items():
        scale = (0.5 * rates).view(-1, *[1] * (tensor.ndim - 1))
        torch.testing.assert_close(tensor, before[name] + scale * leaves[name].grad)


def test_ideas_are_drawn_from_the_distribution():
    own = distribution(robots=1)
    state = torch.rand(1, 2, generator=torch.Generator().manual_seed(2))
    mean, spread = own.distribution(state)
    ideas = ideas_of(own, state, 40000)[0]
    below = torch.distributions.Normal(mean[0], spread[0]).cdf(torch.zeros(2))
    torch.testing.assert_close((ideas < 0).float().mean(0), below, atol=0.01, rtol=0)
    assert (ideas.abs() <= 0.5).all()
    assert torch.equal(own.recall(state), mean)


def test_it_comes_to_the_mean_and_spread_of_what_it_learns():
    own = distribution(robots=1)
    state, random = torch.tensor([[0.3, -0.2]]), torch.Generator().manual_seed(3)
    target = torch.tensor([0.2, -0.1])
    for step in range(6000):
        action = target + 0.15 * torch.randn(1, 2, generator=random)
        own.learn(state, action, torch.ones(1), rate=0.01 / (1 + step / 1000))
    mean, spread = own.distribution(state)
    torch.testing.assert_close(mean[0], target, atol=0.03, rtol=0)
    # At the maximum, sigma^2 = E (a - mu)^2 / (1 - weight of the entropy).
    expected = torch.full((2,), 0.15 / math.sqrt(0.9))
    torch.testing.assert_close(spread[0], expected, atol=0.02, rtol=0)
