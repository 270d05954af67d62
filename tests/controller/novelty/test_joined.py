"""Actions of two proposers."""

import torch

from musebot.controller import RandomActions
from musebot.controller.novelty.joined import Joined
from musebot.controller.proposers import FixedActions


def test_random_actions_follow_the_ideas_of_the_memory():
    ideas = FixedActions((-0.5, 0.5))  # in place of a memory's
    state = torch.zeros(3, 5)
    random = RandomActions(2, torch.Generator().manual_seed(0))
    actions = Joined(ideas, random).propose(state)
    assert actions.shape == (3, 6, 2)
    assert torch.equal(actions[:, :4], ideas.propose(state))
    again = RandomActions(2, torch.Generator().manual_seed(0)).propose(state)
    assert torch.equal(actions[:, 4:], again)
