"""One-hidden-layer networks and their optimizers, against autograd and torch's own."""

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import stats

from musebot.controller import Networks
from musebot.controller.networks import ACTIVATIONS, SGD, Adam

quick = settings(max_examples=30)
shapes = st.fixed_dictionaries(
    {
        "robots": st.integers(1, 4),
        "inputs": st.integers(1, 6),
        "hidden": st.integers(1, 8),
        "outputs": st.integers(1, 3),
        "seed": st.integers(0, 2**31),
        "activation": st.sampled_from(["logistic", "tanh"]),
    }
)


def drawn(robots, inputs, hidden, outputs, seed, initial_range=1.0, activation="logistic"):
    """Networks, an input and a step for each output, all from one seed."""
    generator = torch.Generator().manual_seed(seed)
    networks = Networks(robots, inputs, hidden, outputs, initial_range, generator)
    networks.activation = ACTIVATIONS[activation]
    x = torch.rand(robots, inputs, generator=generator) * 4 - 2
    steps = torch.rand(robots, outputs, generator=generator) * 2 - 1
    return networks, x, steps


def twins(networks):
    """Each robot's weights and biases in double precision, with gradients."""
    return [
        {n: t[robot].double().clone().requires_grad_() for n, t in networks.tensors().items()}
        for robot in range(len(networks.weights))
    ]


def output_sums(w, x, activation):
    function = {"logistic": torch.sigmoid, "tanh": torch.tanh}[activation]
    hidden = function(w["hidden_weights"] @ x.double() + w["hidden_biases"])
    return w["output_weights"] @ hidden + w["output_biases"]


@quick
@given(shapes, st.floats(0, 2))
def test_outputs_and_plain_gradient_steps_equal_those_of_autograd(shape, rate):
    (networks, x, steps), (other, _, _) = drawn(**shape), drawn(**shape)
    hidden, outputs = networks.forward(x)
    assert hidden.shape == (shape["robots"], shape["hidden"])
    assert outputs.shape == (shape["robots"], shape["outputs"])
    before = twins(networks)
    SGD(networks).ascend(x, hidden, steps, rate, torch.ones(shape["robots"]))
    other.weights += rate * other.gradient(x, hidden, steps)
    for robot, w in enumerate(before):
        sums = output_sums(w, x[robot], shape["activation"])
        torch.testing.assert_close(outputs[robot].double(), sums.detach(), atol=1e-5, rtol=1e-5)
        (steps[robot].double() * sums).sum().backward()
        for name, tensor in w.items():
            expected = (tensor + rate * tensor.grad).detach()
            for after in (networks, other):
                found = after.tensors()[name][robot].double()
                torch.testing.assert_close(found, expected, atol=1e-5, rtol=0)


def test_initial_weights_and_biases_are_uniform_and_differ_between_robots():
    networks, _, _ = drawn(500, 7, 7, 1, seed=4, initial_range=0.8)
    for name, tensor in networks.tensors().items():
        assert len(tensor.flatten(1).unique(dim=0)) == 500
        sample = tensor.flatten().numpy()
        assert abs(sample).max() <= 0.8
        assert stats.kstest(sample, stats.uniform(-0.8, 1.6).cdf).pvalue > 0.001, name
        assert stats.kstest(sample, stats.uniform(-1.0, 2.0).cdf).pvalue < 0.001, name


@pytest.mark.usefixtures("double_precision")
def test_adam_equals_torchs_adam_in_the_steps_in_which_a_robot_learns():
    networks, _, _ = drawn(4, 3, 5, 2, seed=1, activation="tanh")
    own = Adam(networks)
    weights = twins(networks)
    torchs = [torch.optim.Adam(w.values(), lr=0.01) for w in weights]
    generator = torch.Generator().manual_seed(2)
    for _ in range(40):
        inputs = torch.rand(4, 3, generator=generator) * 2 - 1
        steps = torch.rand(4, 2, generator=generator) * 2 - 1
        learning = (torch.rand(4, generator=generator) < 0.7).double()
        steps *= learning[:, None]
        own.ascend(inputs, networks.forward(inputs)[0], steps, 0.01, learning)
        for robot in learning.nonzero()[:, 0]:
            torchs[robot].zero_grad()
            (-(steps[robot] * output_sums(weights[robot], inputs[robot], "tanh")).sum()).backward()
            torchs[robot].step()
    for robot, w in enumerate(weights):
        for name, tensor in networks.tensors().items():
            torch.testing.assert_close(tensor[robot], w[name].detach(), atol=1e-10, rtol=0)
