"""The recurrent context: its connections; test_brains has its equation."""

import dataclasses

import numpy as np
import pytest
import torch

from musebot.controller import BRAINS, Neurocontroller, Senses, Signal
from musebot.controller.context import EchoContext

SENSES = Senses((Signal(0.0, 1.0, 10.0), Signal(-1.0, 1.0)), Signal(0.0, 1.0, 10.0))


def context(robots=3, inputs=2, units=4, seed=1):
    return EchoContext(robots, inputs, units, torch.Generator().manual_seed(seed))


def brain(robots=3, seed=1):
    parameters = dataclasses.replace(
        BRAINS["steady"], ideas=5, context_neurons=4, keep_main_idea=True
    )
    return Neurocontroller(parameters, "creative", robots, 2, seed, SENSES)


def units_of(one):
    assert one._context is not None
    return one._context


def sensed(steps, robots=3):
    states = torch.rand(steps, robots, 2, generator=torch.Generator().manual_seed(7))
    states[..., 0] *= 10 / 11
    return states


def test_weights_of_the_inputs_are_drawn_evenly_from_both_signs():
    weights = context(robots=200, inputs=4).weights()["input_weights"] * 4**0.5
    assert weights.abs().max() <= 1 and weights.min() < -0.95 and weights.max() > 0.95
    assert abs(float(weights.mean())) < 0.05


@pytest.mark.parametrize("units", [1, 4, 30])
def test_every_robots_connections_have_the_spectral_radius(units):
    recurrent = context(units=units).weights()["recurrent_weights"].numpy()
    radii = np.abs(np.linalg.eigvals(recurrent)).max(axis=1)
    np.testing.assert_allclose(radii, 0.9, rtol=1e-4)


def test_asking_for_values_and_ideas_does_not_advance_the_context():
    one = brain()
    state = sensed(1)[0]
    for _ in range(2):
        one.propose(state)
        one.values(state, torch.zeros(3, 1, 2))
    assert not units_of(one).values.any()
    one.act(state, explore=False)
    assert units_of(one).values.all()


def test_the_connections_are_stored_with_the_networks_and_never_learn():
    one, other = brain(), brain(seed=5)
    kept = {name: tensor.clone() for name, tensor in one.networks().items()}
    assert {"context.recurrent_weights", "context.input_weights"} < kept.keys()
    for state in sensed(30):
        one.act(state, explore=True)
        one.learn(state[:, 0])
    for name, tensor in one.networks().items():
        assert torch.equal(tensor, kept[name]) is name.startswith("context."), name
    other.load_networks(kept)
    assert torch.equal(units_of(other).weights()["recurrent_weights"],
                       kept["context.recurrent_weights"])  # fmt: skip
