"""The connections of the recurrent context; test_presets has its equation."""

import numpy as np
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from musebot.controller import BRAINS, Neurocontroller, Senses, Signal
from musebot.controller.context import EchoContext


def connections(robots=3, inputs=2, units=4):
    return EchoContext(robots, inputs, units, torch.Generator().manual_seed(1)).weights()


def test_weights_of_the_inputs_are_drawn_evenly_from_both_signs():
    weights = connections(robots=200, inputs=4)["input_weights"] * 4**0.5
    assert weights.abs().max() <= 1 and weights.min() < -0.95 and weights.max() > 0.95
    assert abs(float(weights.mean())) < 0.05


@settings(max_examples=20)
@given(st.integers(1, 30))
def test_every_robots_connections_have_the_spectral_radius(units):
    recurrent = connections(units=units)["recurrent_weights"].numpy()
    radii = np.abs(np.linalg.eigvals(recurrent)).max(axis=1)
    np.testing.assert_allclose(radii, 0.9, rtol=1e-4)


def test_only_acting_advances_the_context():
    signal = Signal(0.0, 1.0, 10.0)
    brain = Neurocontroller(BRAINS["recurrent"], "creative", 3, Senses((signal,), signal), 1)
    state = torch.rand(3, 1)
    brain.propose(state)
    brain.values(state, torch.zeros(3, 1, 2))
    assert not brain.state()["context.values"].any()
    brain.act(state, explore=False)
    assert brain.state()["context.values"].all()
