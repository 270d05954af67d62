"""Outputs and gradients of one-hidden-layer networks against autograd; Adam against torch's."""

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import stats

from musebot.controller import Networks
from musebot.controller.networks import ACTIVATIONS, SGD, Adam, load_into

quick = settings(deadline=None, max_examples=30)
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


def weights(networks, robot):
    """One robot's weights and biases in double precision, with gradients."""
    return {
        name: tensor[robot].double().clone().requires_grad_()
        for name, tensor in networks.tensors().items()
    }


def output_sums(w, x, activation):
    function = {"logistic": torch.sigmoid, "tanh": torch.tanh}[activation]
    hidden = function(w["hidden_weights"] @ x.double() + w["hidden_biases"])
    return w["output_weights"] @ hidden + w["output_biases"]


@quick
@given(shapes)
def test_forward_equals_a_hidden_layer_and_a_linear_output_layer(shape):
    networks, x, _ = drawn(**shape)
    hidden, output = networks.forward(x)
    assert hidden.shape == (shape["robots"], shape["hidden"])
    assert output.shape == (shape["robots"], shape["outputs"])
    for robot in range(shape["robots"]):
        w = weights(networks, robot)
        torch.testing.assert_close(
            output[robot].double(),
            output_sums(w, x[robot], shape["activation"]).detach(),
            atol=1e-5,
            rtol=1e-5,
        )


@quick
@given(shapes)
def test_ascend_follows_the_gradient_of_autograd(shape):
    networks, x, steps = drawn(**shape)
    expected = []
    for robot in range(shape["robots"]):
        w = weights(networks, robot)
        sums = output_sums(w, x[robot], shape["activation"])
        (steps[robot].double() * sums).sum().backward()
        expected.append({name: (t + t.grad).detach() for name, t in w.items()})
    networks.ascend(x, networks.forward(x)[0], steps)
    for robot, after in enumerate(expected):
        for name, tensor in networks.tensors().items():
            torch.testing.assert_close(tensor[robot].double(), after[name], atol=1e-5, rtol=0)


@quick
@given(shapes)
def test_adding_the_gradient_equals_ascend(shape):
    (one, x, steps), (other, _, _) = drawn(**shape), drawn(**shape)
    one.ascend(x, one.forward(x)[0], steps)
    other.weights += other.gradient(x, other.forward(x)[0], steps)
    for name, tensor in one.tensors().items():
        torch.testing.assert_close(tensor, other.tensors()[name], atol=1e-6, rtol=1e-6)


def test_initial_weights_and_biases_are_uniform_in_the_initial_range():
    networks, _, _ = drawn(500, 7, 7, 1, seed=4, initial_range=0.8)
    for name, tensor in networks.tensors().items():
        sample = tensor.flatten().numpy()
        assert abs(sample).max() <= 0.8
        assert stats.kstest(sample, stats.uniform(-0.8, 1.6).cdf).pvalue > 0.001, name
        assert stats.kstest(sample, stats.uniform(-1.0, 2.0).cdf).pvalue < 0.001, name


def test_initial_networks_differ_between_robots():
    networks, _, _ = drawn(50, 3, 7, 1, seed=5)
    for tensor in networks.tensors().values():
        assert len(tensor.flatten(1).unique(dim=0)) == 50


@pytest.mark.parametrize("name", ["hidden_weights", "output_biases"])
def test_load_refuses_a_missing_or_misshapen_tensor_by_name_and_changes_nothing(name):
    networks, _, _ = drawn(2, 3, 4, 1, seed=6)
    other, _, _ = drawn(2, 3, 4, 1, seed=7)
    before = {name: tensor.clone() for name, tensor in networks.tensors().items()}
    tensors = other.tensors()
    with pytest.raises(ValueError, match=f"{name} is missing"):
        load_into(networks.tensors(), {k: t for k, t in tensors.items() if k != name})
    with pytest.raises(ValueError, match=f"{name} must have shape"):
        load_into(networks.tensors(), tensors | {name: tensors[name][:1]})
    assert all(torch.equal(before[k], tensor) for k, tensor in networks.tensors().items())


# Optimizers

ROBOTS, INPUTS, HIDDEN, OUTPUTS = 4, 3, 5, 2


def initial():
    return drawn(ROBOTS, INPUTS, HIDDEN, OUTPUTS, seed=1, activation="tanh")[0]


def updates(count, seed=2):
    """Inputs, errors and who learns in each step; no robot learns in every step."""
    generator = torch.Generator().manual_seed(seed)
    for _ in range(count):
        inputs = torch.rand(ROBOTS, INPUTS, generator=generator) * 2 - 1
        steps = torch.rand(ROBOTS, OUTPUTS, generator=generator) * 2 - 1
        learning = (torch.rand(ROBOTS, generator=generator) < 0.7).double()
        yield inputs, steps * learning[:, None], learning


def train(networks, optimizer, rate, count=40):
    for inputs, steps, learning in updates(count):
        hidden, _ = networks.forward(inputs)
        optimizer.ascend(inputs, hidden, steps, rate, learning)


@pytest.mark.usefixtures("double_precision")
def test_adam_equals_torchs_adam_in_the_steps_in_which_a_robot_learns():
    networks = initial()
    twins = [
        {
            name: tensor[robot].clone().requires_grad_()
            for name, tensor in networks.tensors().items()
        }
        for robot in range(ROBOTS)
    ]
    torchs = [torch.optim.Adam(twin.values(), lr=0.01) for twin in twins]
    train(networks, Adam(networks), 0.01)
    for inputs, steps, learning in updates(40):
        for robot, (w, adam) in enumerate(zip(twins, torchs, strict=True)):
            if learning[robot]:
                adam.zero_grad()
                hidden = torch.tanh(w["hidden_weights"] @ inputs[robot] + w["hidden_biases"])
                output = w["output_weights"] @ hidden + w["output_biases"]
                (-(steps[robot] * output).sum()).backward()
                adam.step()
    for robot, w in enumerate(twins):
        for name, tensor in networks.tensors().items():
            torch.testing.assert_close(tensor[robot], w[name].detach(), atol=1e-10, rtol=0)


@quick
@given(shapes, st.floats(0, 2))
def test_a_plain_gradient_step_is_the_gradient_times_the_learn_rate(shape, rate):
    (one, x, steps), (other, _, _) = drawn(**shape), drawn(**shape)
    SGD(one).ascend(x, one.forward(x)[0], steps, rate, torch.ones(shape["robots"]))
    other.weights += rate * other.gradient(x, other.forward(x)[0], steps)
    torch.testing.assert_close(one.weights, other.weights, atol=1e-6, rtol=1e-6)
