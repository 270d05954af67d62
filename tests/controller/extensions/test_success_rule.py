"""The one-fifth success rule for the noise of the creative memory."""

import dataclasses
import math

import pytest
import torch
from helpers import ideas_of
from hypothesis import given, settings
from hypothesis import strategies as st

from musebot.controller import BRAINS, Neurocontroller
from musebot.controller.extensions.success_rule import SuccessRule
from musebot.controller.senses import Senses, Signal

quick = settings(deadline=None, max_examples=30)


def test_the_noise_after_one_step_by_hand():
    rule = SuccessRule(3, 0.5)
    # Shares of success 0, 1/5 and 1 of five ideas; an equal value is no success.
    values = torch.tensor([
        [1.0, 1, 0, 0, 0, 0],
        [1.0, 2, 0, 0, 0, 0],
        [1.0, 2, 2, 2, 2, 2],
    ])  # fmt: skip
    rule.update(values)
    expected = torch.tensor([[math.exp(-0.1)], [1.0], [math.exp(0.4)]])
    torch.testing.assert_close(rule.scale, expected)


@quick
@given(st.integers(0, 10**6), st.integers(2, 30), st.floats(0.001, 1))
def test_each_robot_has_its_own_noise(seed, ideas, rate):
    together, alone = SuccessRule(3, rate), SuccessRule(1, rate)
    random = torch.Generator().manual_seed(seed)
    for _ in range(20):
        values = torch.rand(3, ideas, generator=random)
        together.update(values)
        alone.update(values[1:2])
    torch.testing.assert_close(together.scale[1:2], alone.scale)


@pytest.mark.parametrize(("sign", "bound"), [(1, 10.0), (-1, 0.01)])
def test_the_noise_ends_at_its_bounds(sign, bound):
    rule = SuccessRule(2, 1.0)
    for _ in range(60):
        rule.update(sign * torch.arange(5.0).expand(2, -1))
    torch.testing.assert_close(rule.scale, torch.full((2, 1), bound))


def steady(**fields):
    senses = Senses((Signal(0.0, 1.0, 10.0),), Signal(0.0, 1.0, 10.0))
    parameters = dataclasses.replace(BRAINS["steady"], keep_main_idea=True, **fields)
    return Neurocontroller(parameters, "creative", 2, 1, 3, senses)


def test_the_rule_adapts_the_noise_in_training_only_and_is_stored_with_the_networks():
    brain = steady(noise_adaptation=0.1)
    state = torch.full((2, 1), 0.4)
    for _ in range(5):
        brain.act(state, explore=False)
    assert (brain.networks()["memory.noise_scale"] == 1).all()
    brain.act(state, explore=True)
    adapted = brain.networks()["memory.noise_scale"].clone()
    assert not (adapted == 1).any()
    other = steady(noise_adaptation=0.1)
    other.load_networks(brain.networks())
    assert torch.equal(other.networks()["memory.noise_scale"], adapted)
    assert "memory.noise_scale" not in steady().networks()


def test_ideas_have_the_adapted_noise():
    memory = steady(noise_adaptation=0.1).memory
    state = torch.zeros(2, 2)
    memory.rule.scale[:] = torch.tensor([[0.0], [1.0]])
    ideas, main = ideas_of(memory, state, 9), memory.recall(state)
    torch.testing.assert_close(ideas[0], main[:1].expand(9, -1))
    torch.testing.assert_close(ideas[1, 0], main[1])
    assert (ideas[1, 1:] - main[1]).norm(dim=1).max() > 0.01
