"""The three action proposers of section 3."""

import pytest
import torch
from helpers import unit_senses
from scipy import stats

from musebot.controller import PROPOSERS, Neurocontroller, Parameters


def proposed(proposer, robots, state=0.0, **fields):
    brain = Neurocontroller(Parameters(**fields), proposer, robots, unit_senses(5), seed=3)
    return brain.propose(torch.full((robots, 5), state))


@pytest.mark.parametrize("proposer", PROPOSERS)
def test_every_proposer_offers_25_actions_to_every_robot(proposer):
    actions = proposed(proposer, 3)
    assert actions.shape == (3, 25, 2) and actions.dtype == torch.float32
    assert actions.abs().max() <= 0.5
    assert actions.equal(proposed(proposer, 3, 1.0)) == (proposer != "creative")


def test_the_fixed_actions_are_all_pairs_of_some_motor_values():
    values = (-0.5, -0.25, 0.0, 0.25, 0.5)
    for own in proposed("fixed", 2).tolist():
        assert sorted(map(tuple, own)) == [(left, right) for left in values for right in values]
    assert proposed("fixed", 1, fixed_motors=(0,)).tolist() == [[[0.0, 0.0]]]


def test_random_actions_are_uniform_in_the_square_and_drawn_anew_in_every_step():
    brain = Neurocontroller(Parameters(), "random", 40, unit_senses(5), seed=3)
    actions = torch.stack([brain.propose(torch.zeros(40, 5)) for _ in range(20)])
    left, right = actions.reshape(-1, 2).double().numpy().T
    for motor in (left, right):
        assert stats.kstest(motor, stats.uniform(-0.5, 1.0).cdf).pvalue > 0.001
    assert stats.pearsonr(left, right).pvalue > 0.001
    assert len(actions.flatten(0, 2).unique(dim=0)) > 0.999 * 20 * 40 * 25


def test_creative_actions_are_the_ideas_of_the_memory_and_then_random_ones():
    parameters = Parameters(random_share=0.2)
    one, other = (
        Neurocontroller(parameters, "creative", 3, unit_senses(5), seed) for seed in (0, 1)
    )
    other.load_state(one.state())
    state = torch.rand(3, 5)
    other.memory.patterns.renew()
    ideas = other.memory.ideas(state, 20)
    random = torch.rand(3, 5, 2, generator=other.generator) - 0.5
    assert torch.equal(one.propose(state), torch.cat([ideas, random], dim=1))
