"""The three action proposers of section 3."""

import pytest
import torch
from scipy import stats

from musebot.controller import (
    PROPOSERS,
    CreativeMemory,
    Neurocontroller,
    Parameters,
    RandomActions,
)
from musebot.controller.proposers import CreativeActions, FixedActions


def fixed_actions(robots=2):
    proposer = FixedActions(Parameters().fixed_motors)
    return [[tuple(a) for a in own] for own in proposer.propose(torch.zeros(robots, 1)).tolist()]


def test_the_fixed_actions_are_the_papers_25_pairs_for_every_robot():
    values = (-0.5, -0.25, 0.0, 0.25, 0.5)
    for own in fixed_actions():
        assert len(own) == 25
        assert set(own) == {(left, right) for left in values for right in values}


def test_fixed_actions_of_whole_numbers_are_floats():
    (actions,) = FixedActions((0,)).propose(torch.zeros(1, 2))
    assert actions.dtype == torch.float32 and actions.tolist() == [[0, 0]]


def test_the_fixed_actions_do_not_depend_on_the_state():
    proposer = FixedActions((-0.5, 0.1))
    first, second = proposer.propose(torch.zeros(3, 4)), proposer.propose(torch.ones(3, 4))
    assert torch.equal(first, second)
    assert first.shape == (3, 4, 2)


def uniform_enough(actions):
    """Tests each motor value for uniformity, and both for correlation."""
    left, right = actions.reshape(-1, 2).double().numpy().T
    whole = stats.uniform(-0.5, 1.0)
    tests = (
        stats.kstest(left, whole.cdf),
        stats.kstest(right, whole.cdf),
        stats.pearsonr(left, right),
    )
    return min(test.pvalue for test in tests) > 0.001


def test_random_actions_are_uniform_in_the_square():
    proposer = RandomActions(25, torch.Generator().manual_seed(3))
    actions = torch.stack([proposer.propose(torch.zeros(40, 5)) for _ in range(20)])
    assert actions.shape == (20, 40, 25, 2)
    assert actions.abs().max() <= 0.5
    assert uniform_enough(actions)


@pytest.mark.parametrize(
    "wrong",
    [
        lambda u: u**1.1 - 0.5,
        lambda u: (u - 0.5) * 0.95,
        lambda u: (u - 0.5)[..., :1].expand_as(u),
        lambda u: torch.randn(u.shape, generator=torch.Generator().manual_seed(1)).clamp(-0.5, 0.5),
    ],
    ids=["skewed", "narrow", "both motors equal", "clipped normal"],
)
def test_the_check_detects_a_wrong_distribution(wrong):
    u = torch.rand(20, 40, 25, 2, generator=torch.Generator().manual_seed(3))
    assert uniform_enough(u - 0.5)
    assert not uniform_enough(wrong(u))


def test_creative_actions_are_the_ideas_of_the_memory_and_then_the_random_ones():
    generator = torch.Generator().manual_seed(0)
    memory = CreativeMemory(Parameters(), 3, 5, generator)
    memory.patterns.renew()
    state, start = torch.rand(3, 5), generator.get_state()
    ideas = memory.ideas(state, 20)
    others = RandomActions(5, generator)
    random = others.propose(state)
    generator.set_state(start)
    assert torch.equal(CreativeActions(memory, 20, None).propose(state), ideas)
    generator.set_state(start)
    both = CreativeActions(memory, 20, others).propose(state)
    assert torch.equal(both, torch.cat([ideas, random], dim=1))


@pytest.mark.parametrize("proposer", PROPOSERS)
def test_every_proposer_offers_25_actions_to_every_robot(proposer):
    actions = Neurocontroller(Parameters(), proposer, 3, 5, seed=0).propose(torch.rand(3, 5))
    assert actions.shape == (3, 25, 2)
    assert actions.abs().max() <= 0.5
