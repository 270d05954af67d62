"""Outputs and gradients of one-hidden-layer networks, against autograd."""

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import stats

from musebot.controller import Networks
from musebot.controller.networks import ACTIVATIONS, load_into

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


def only(networks, robot):
    """A batch of one, with the weights of one robot of a batch."""
    robots, hidden, inputs = networks.hidden_weights.shape
    outputs = networks.output_biases.shape[1]
    alone = Networks(1, inputs, hidden, outputs, 1.0, torch.Generator())
    alone.activation = networks.activation
    load_into(
        alone.tensors(), {name: t[robot : robot + 1] for name, t in networks.tensors().items()}
    )
    return alone


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
    other.add(other.gradient(x, other.forward(x)[0], steps))
    for name, tensor in one.tensors().items():
        torch.testing.assert_close(tensor, other.tensors()[name], atol=1e-6, rtol=1e-6)


@quick
@given(shapes)
def test_a_batch_equals_batches_of_one(shape):
    networks, x, steps = drawn(**shape)
    alone = [only(networks, robot) for robot in range(shape["robots"])]
    hidden, output = networks.forward(x)
    networks.ascend(x, hidden, steps)
    for robot, single in enumerate(alone):
        row = slice(robot, robot + 1)
        own_hidden, own_output = single.forward(x[row])
        torch.testing.assert_close(output[row], own_output, atol=1e-6, rtol=1e-6)
        single.ascend(x[row], own_hidden, steps[row])
        for name, tensor in single.tensors().items():
            torch.testing.assert_close(networks.tensors()[name][row], tensor, atol=1e-6, rtol=1e-6)


def test_a_step_of_zero_changes_nothing():
    networks, x, steps = drawn(3, 4, 5, 2, seed=0)
    before = {name: tensor.clone() for name, tensor in networks.tensors().items()}
    networks.ascend(x, networks.forward(x)[0], torch.zeros_like(steps))
    assert all(torch.equal(before[name], t) for name, t in networks.tensors().items())


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


def test_load_overwrites_in_place():
    networks, x, _ = drawn(2, 3, 4, 1, seed=6)
    other, _, _ = drawn(2, 3, 4, 1, seed=7)
    before = networks.tensors()
    load_into(networks.tensors(), other.tensors())
    assert all(networks.tensors()[name] is tensor for name, tensor in before.items())
    assert torch.equal(networks.forward(x)[1], other.forward(x)[1])


@pytest.mark.parametrize("name", Networks.NAMES)
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


def test_a_removed_connection_stays_removed_and_the_others_follow_the_gradient():
    shape = {"robots": 2, "inputs": 3, "hidden": 4, "outputs": 1, "seed": 7}
    connected = torch.tensor([[1.0, 0, 1], [1, 1, 0], [0, 0, 0], [1, 1, 1]])
    (one, x, steps), (other, _, _), (whole, _, _) = (drawn(**shape) for _ in range(3))
    for networks in (one, other):
        networks.disconnect(connected)
    whole.hidden_weights *= connected
    for _ in range(3):
        one.ascend(x, one.forward(x)[0], steps)
        other.add(other.gradient(x, other.forward(x)[0], steps))
        whole.ascend(x, whole.forward(x)[0], steps)
        whole.hidden_weights *= connected
    assert not one.hidden_weights[:, connected == 0].any()
    for name, tensor in one.tensors().items():
        torch.testing.assert_close(tensor, other.tensors()[name], atol=1e-6, rtol=1e-6)
        torch.testing.assert_close(tensor, whole.tensors()[name], atol=1e-6, rtol=1e-6)
