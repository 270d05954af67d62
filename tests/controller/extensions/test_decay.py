"""Decay of epsilon and of the learn rate."""

import math

import pytest
import torch

from musebot.controller import Parameters
from musebot.controller.brains import assemble
from musebot.controller.extensions.decay import Decay


def parts(parameters):
    return assemble(parameters, "fixed", 1, 1, torch.Generator().manual_seed(0), None)


def after(schedule, age):
    schedule.update(torch.tensor(age))
    return schedule.value


DECAYING = Parameters(
    epsilon=0.04,
    initial_epsilon=0.3,
    epsilon_decay_steps=24000,
    learn_rate=0.0002,
    initial_learn_rate=0.002,
    learn_rate_decay_steps=62400,
)


@pytest.mark.parametrize(
    ("age", "epsilon"), [(0, 0.3), (24000, 0.04 + 0.26 / math.e), (10**7, 0.04)]
)
def test_epsilon_decays_exponentially(age, epsilon):
    assert after(parts(DECAYING).epsilon, age) == pytest.approx(epsilon)


@pytest.mark.parametrize(
    ("age", "rate"), [(0, 0.002), (62400, 0.0002 + 0.0018 / math.e), (10**7, 0.0002)]
)
def test_the_learn_rate_decays_exponentially(age, rate):
    assert after(parts(DECAYING).learn_rate, age) == pytest.approx(rate)


def test_the_papers_parameters_are_constant():
    paper = parts(Parameters())
    for age in (0, 10**7):
        assert after(paper.epsilon, age) == 0.01
        assert after(paper.learn_rate, age) == 0.01


def test_on_another_device_a_whole_number_decays_through_fractions():
    with torch.device("meta"):
        decaying = Decay(1, 0, 10.0)
    assert decaying.value.dtype == torch.float32


def test_on_another_device_a_decaying_value_is_a_tensor_that_keeps_its_place():
    """A recorded step reads it where it was when the step was recorded."""
    with torch.device("meta"):
        decaying, constant = parts(DECAYING).epsilon, parts(Parameters()).epsilon
    places = {id(after(decaying, age)) for age in (0, 1, 10**7)}
    assert len(places) == 1 and decaying.value.device.type == "meta"
    assert after(constant, 10**7) == 0.01
