"""What the memory learns beyond the paper."""

import torch

from musebot.controller.extensions.memory_targets import best_action
from musebot.controller.extensions.step import DetailedStep


def test_the_lesson_is_the_best_action_at_the_learn_rate():
    step, learning = DetailedStep(3, 5), torch.tensor([1.0, 0.0, 1.0])
    step.best_action = torch.rand(3, 2)
    action, rates, rate = best_action(step, torch.rand(3), learning, 0.01)
    assert action is step.best_action
    assert rates is learning
    assert rate == 0.01
