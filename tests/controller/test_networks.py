"""Initial weights of one-hidden-layer networks; test_presets.py has how they learn."""

import torch
from scipy import stats

from musebot.controller.networks import Networks


def test_initial_weights_and_biases_are_uniform_and_differ_between_robots():
    networks = Networks(500, 7, 7, 1, 0.8, torch.Generator().manual_seed(4))
    for name, tensor in networks.tensors().items():
        assert len(tensor.flatten(1).unique(dim=0)) == 500
        sample = tensor.flatten().numpy()
        assert abs(sample).max() <= 0.8
        assert stats.kstest(sample, stats.uniform(-0.8, 1.6).cdf).pvalue > 0.001, name
        assert stats.kstest(sample, stats.uniform(-1.0, 2.0).cdf).pvalue < 0.001, name
