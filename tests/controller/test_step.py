"""A remembered step, the paper's and the detailed one."""

import pytest
import torch

from musebot.controller.extensions.step import DetailedStep
from musebot.controller.step import Step


def recorded(kind):
    step = kind(2, 3)
    state, actions = torch.rand(2, 3), torch.rand(2, 4, 2)
    values = torch.tensor([[1.0, 2.0, 3.0, 4.0], [5.0, 6.0, 7.0, 8.0]])
    step.record(state, actions, values, torch.tensor([0, 2]), torch.tensor([3, 1]))
    return step, state, actions


@pytest.mark.parametrize("kind", [Step, DetailedStep])
def test_a_step_records_the_selected_action_and_its_value(kind):
    step, state, actions = recorded(kind)
    assert torch.equal(step.state, state)
    assert torch.equal(step.action, actions[[0, 1], [0, 2]])
    assert step.value.tolist() == [1, 7]
    assert step.chained.tolist() == [1, 1]


def test_a_detailed_step_records_the_best_action_and_its_value_but_no_reward():
    step, _, actions = recorded(DetailedStep)
    assert torch.equal(step.best_action, actions[[0, 1], [3, 1]])
    assert step.best_value.tolist() == [4, 6]
    assert not step.rewarded


def test_nothing_is_chained_to_a_step_that_is_new_or_forgotten():
    assert Step(2, 3).chained.tolist() == [0, 0]
    step, _, _ = recorded(Step)
    step.forget(torch.tensor([1]))
    assert step.chained.tolist() == [1, 0]
    step.forget()
    assert step.chained.tolist() == [0, 0]


@pytest.mark.parametrize("kind", [Step, DetailedStep])
def test_a_step_is_restored_from_its_tensors(kind):
    step, _, _ = recorded(kind)
    step.forget(torch.tensor([1]))
    step.reward, step.rewarded = torch.tensor([0.5, -0.5]), torch.tensor(True)
    kept, other = step.tensors(), kind(2, 3)
    values = {name: tensor.tolist() for name, tensor in kept.items()}
    step.forget()
    other.load(kept)
    assert {name: tensor.tolist() for name, tensor in other.tensors().items()} == values
