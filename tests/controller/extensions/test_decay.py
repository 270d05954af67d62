"""Decay of epsilon and of the learn rate."""

import math

import pytest
import torch

from musebot.controller import Parameters
from musebot.controller.brains import assemble


def parts(parameters):
    return assemble(parameters, "fixed", 1, 1, torch.Generator().manual_seed(0), None)


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
    assert parts(DECAYING).epsilon(torch.tensor(age)) == pytest.approx(epsilon)


@pytest.mark.parametrize(
    ("age", "rate"), [(0, 0.002), (62400, 0.0002 + 0.0018 / math.e), (10**7, 0.0002)]
)
def test_the_learn_rate_decays_exponentially(age, rate):
    assert parts(DECAYING).learn_rate(torch.tensor(age)) == pytest.approx(rate)


def test_the_papers_parameters_are_constant():
    paper = parts(Parameters())
    for age in (0, 10**7):
        assert paper.epsilon(torch.tensor(age)) == 0.01
        assert paper.learn_rate(torch.tensor(age)) == 0.01
