"""The plain gradient step of Eq. 1."""

import torch

from musebot.controller import Networks
from musebot.controller.optimizers import SGD


def initial():
    return Networks(4, 3, 5, 2, 1.0, torch.Generator().manual_seed(1))


def test_steps_are_the_gradient_times_the_learn_rate(double_precision):
    networks, other = initial(), initial()
    generator = torch.Generator().manual_seed(2)
    inputs = torch.rand(4, 3, generator=generator) * 2 - 1
    steps = torch.rand(4, 2, generator=generator) * 2 - 1
    hidden, _ = networks.forward(inputs)
    SGD(networks).ascend(inputs, hidden, steps, 0.3, 1.0)
    other.add(0.3 * other.gradient(inputs, hidden, steps))
    for name, tensor in networks.tensors().items():
        torch.testing.assert_close(tensor, other.tensors()[name], atol=1e-12, rtol=0)
