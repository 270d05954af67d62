"""The evaluation network: values, and TD(0) as Eq. 1 has it, against autograd."""

import math

import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from musebot.controller import EvaluationNetwork, Parameters

quick = settings(deadline=None, max_examples=30)
numbers = st.floats(-3, 3, width=32)


@st.composite
def situations(draw):
    """An evaluation network, and everything that a step of learning needs."""
    robots, sensors = draw(st.integers(1, 4)), draw(st.integers(1, 5))
    parameters = Parameters(
        evaluation_hidden=draw(st.integers(1, 8)),
        learn_rate=draw(st.floats(0, 0.5)),
        discount=draw(st.floats(0, 1)),
        error_limit=draw(st.none() | st.floats(0.01, 3)),
    )
    generator = torch.Generator().manual_seed(draw(st.integers(0, 2**31)))
    network = EvaluationNetwork(parameters, robots, sensors, generator)
    several = st.lists(numbers, min_size=robots, max_size=robots).map(torch.tensor)
    return {
        "parameters": parameters,
        "network": network,
        "state": torch.rand(robots, sensors, generator=generator) * 2 - 1,
        "action": torch.rand(robots, 2, generator=generator) - 0.5,
        "reward": draw(several),
        "next_value": draw(several),
    }


def copies(network, robot):
    return {
        name: tensor[robot].double().clone().requires_grad_()
        for name, tensor in network.networks.tensors().items()
    }


def value(w, state, action):
    x = torch.cat([state, action]).double()
    hidden = torch.sigmoid(w["hidden_weights"] @ x + w["hidden_biases"])
    return (w["output_weights"] @ hidden + w["output_biases"])[0]


def descend(w, loss, rate):
    """A step of plain gradient descent, by autograd."""
    loss.backward()
    return {name: (tensor - rate * tensor.grad).detach() for name, tensor in w.items()}


@quick
@given(st.integers(1, 4), st.integers(1, 5), st.integers(1, 30), st.integers(0, 2**31))
def test_values_of_many_actions_are_those_of_one_after_the_other(robots, sensors, count, seed):
    generator = torch.Generator().manual_seed(seed)
    network = EvaluationNetwork(Parameters(), robots, sensors, generator)
    state = torch.rand(robots, sensors, generator=generator) * 2 - 1
    actions = torch.rand(robots, count, 2, generator=generator) - 0.5
    values = network.values(state, actions)
    assert values.shape == (robots, count)
    for index in range(count):
        _, one = network.networks.forward(torch.cat([state, actions[:, index]], dim=1))
        torch.testing.assert_close(values[:, index], one[:, 0], atol=1e-5, rtol=1e-5)


@quick
@given(situations())
def test_learning_is_gradient_descent_on_half_the_squared_error_or_hubers_loss(given_):
    parameters, network = given_["parameters"], given_["network"]
    limit = parameters.error_limit or math.inf
    wanted, errors = [], []
    for robot in range(len(given_["state"])):
        w = copies(network, robot)
        v = value(w, given_["state"][robot], given_["action"][robot])
        target = (given_["reward"] + parameters.discount * given_["next_value"])[robot].double()
        error = abs(target - v)
        loss = error**2 / 2 if error < limit else limit * (error - limit / 2)
        errors.append(min(limit, max(-limit, (target - v).item())))
        wanted.append(descend(w, loss, parameters.learn_rate))
    error = network.learn(*(given_[k] for k in ("state", "action", "reward", "next_value")))
    torch.testing.assert_close(error.double(), torch.tensor(errors).double(), atol=1e-5, rtol=0)
    for robot, after in enumerate(wanted):
        for name, tensor in network.networks.tensors().items():
            torch.testing.assert_close(tensor[robot].double(), after[name], atol=1e-5, rtol=0)


def test_the_next_value_is_not_differentiated_though_the_same_network_gives_it():
    generator = torch.Generator().manual_seed(1)
    parameters = Parameters(learn_rate=0.5)
    network = EvaluationNetwork(parameters, 1, 2, generator)
    state, following = torch.rand(2, 1, 2, generator=generator)
    action, then = torch.rand(2, 1, 2, generator=generator) - 0.5

    def step(differentiate):
        w = copies(network, 0)
        ahead = value(w, following[0], then[0])
        target = 1 + parameters.discount * (ahead if differentiate else ahead.detach())
        return descend(w, (target - value(w, state[0], action[0])) ** 2 / 2, 0.5)

    semi, full = step(False), step(True)
    ahead = network.values(following, then[:, None])[:, 0]
    network.learn(state, action, torch.ones(1), ahead)
    for name, tensor in network.networks.tensors().items():
        torch.testing.assert_close(tensor[0].double(), semi[name], atol=1e-5, rtol=0)
    assert (semi["hidden_weights"] - full["hidden_weights"]).abs().max() > 1e-3


@quick
@given(situations(), st.data())
def test_a_robot_that_does_not_learn_keeps_its_weights_and_others_do_not_notice(given_, data):
    network = given_["network"]
    robots = len(given_["state"])
    mask = data.draw(st.lists(st.sampled_from([0.0, 1.0]), min_size=robots, max_size=robots))
    learning = torch.tensor(mask)
    before = {k: t.clone() for k, t in network.networks.tensors().items()}
    step = [given_[k] for k in ("state", "action", "reward", "next_value")]
    full_error = network.learn(*step)
    full = {k: t.clone() for k, t in network.networks.tensors().items()}
    network.networks.load(before)
    error = network.learn(*step, learning)
    for robot in range(robots):
        source = full if learning[robot] else before
        for name, tensor in network.networks.tensors().items():
            assert torch.equal(tensor[robot], source[name][robot])
        assert error[robot] == (full_error[robot] if learning[robot] else 0)


@quick
@given(situations())
def test_a_robot_learns_the_same_alone_and_among_others(given_):
    network = given_["network"]
    robots, sensors = given_["state"].shape
    alone = []
    for robot in range(robots):
        single = EvaluationNetwork(given_["parameters"], 1, sensors, torch.Generator())
        row = slice(robot, robot + 1)
        single.networks.load({k: t[row] for k, t in network.networks.tensors().items()})
        single.learn(*(given_[k][row] for k in ("state", "action", "reward", "next_value")))
        alone.append(single)
    network.learn(*(given_[k] for k in ("state", "action", "reward", "next_value")))
    for robot, single in enumerate(alone):
        for name, tensor in network.networks.tensors().items():
            own = single.networks.tensors()[name][0]
            torch.testing.assert_close(tensor[robot], own, atol=1e-6, rtol=1e-6)
