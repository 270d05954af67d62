"""The paper's epsilon-greedy exploration; its statistics are tested in test_neurocontroller."""

import torch

from musebot.controller.exploration import EpsilonGreedy


def test_an_exploratory_action_is_one_of_the_ideas():
    ideas = torch.rand(300, 25, 2)
    exploration = EpsilonGreedy(torch.Generator().manual_seed(0))
    actions, index = exploration.draw(ideas, 0.5)
    assert actions is ideas
    assert 100 < (index == -1).sum() < 200
    assert index.max() < 25
    assert (exploration.draw(ideas, 0.0)[1] == -1).all()
    assert (exploration.draw(ideas, 1.0)[1] >= 0).all()
