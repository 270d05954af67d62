"""Values of the evaluation network, and TD(0) by Eq. 1, against autograd."""

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from musebot.controller import EvaluationNetwork, Parameters
from musebot.controller.evaluation_network import TDTarget
from musebot.controller.networks import load_into
from musebot.controller.step import Step

quick = settings(deadline=None, max_examples=30)
numbers = st.floats(-3, 3, width=32)


@st.composite
def situations(draw):
    """An evaluation network, and the arguments of one step of learning."""
    robots, sensors = draw(st.integers(1, 4)), draw(st.integers(1, 5))
    parameters = Parameters(
        evaluation_hidden=draw(st.integers(1, 8)),
        learn_rate=draw(st.floats(0, 0.5)),
    )
    generator = torch.Generator().manual_seed(draw(st.integers(0, 2**31)))
    network = EvaluationNetwork(parameters, robots, sensors, generator)
    several = st.lists(numbers, min_size=robots, max_size=robots).map(torch.tensor)
    return {
        "parameters": parameters,
        "network": network,
        "state": torch.rand(robots, sensors, generator=generator) * 2 - 1,
        "action": torch.rand(robots, 2, generator=generator) - 0.5,
        "target": draw(several),
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
    """One step of plain gradient descent by autograd."""
    loss.backward()
    return {name: (tensor - rate * tensor.grad).detach() for name, tensor in w.items()}


@quick
@given(st.integers(1, 4), st.integers(1, 5), st.integers(1, 30), st.integers(0, 2**31))
def test_values_of_several_actions_equal_the_values_of_single_ones(robots, sensors, count, seed):
    generator = torch.Generator().manual_seed(seed)
    network = EvaluationNetwork(Parameters(), robots, sensors, generator)
    state = torch.rand(robots, sensors, generator=generator) * 2 - 1
    actions = torch.rand(robots, count, 2, generator=generator) - 0.5
    values = network.values(state, actions)
    assert values.shape == (robots, count)
    for index in range(count):
        _, one = network.networks.forward(torch.cat([state, actions[:, index]], dim=1))
        torch.testing.assert_close(values[:, index], one[:, 0], atol=1e-5, rtol=1e-5)


def learn(network, situation, learning=1.0):
    arguments = (situation[name] for name in ("state", "action", "target"))
    return network.learn(*arguments, learning, situation["parameters"].learn_rate)


@quick
@given(situations())
def test_learning_is_gradient_descent_on_half_the_squared_error(situation):
    parameters, network = situation["parameters"], situation["network"]
    expected, errors = [], []
    for robot in range(len(situation["state"])):
        w = copies(network, robot)
        v = value(w, situation["state"][robot], situation["action"][robot])
        error = situation["target"][robot].double() - v
        errors.append(error.item())
        expected.append(descend(w, error**2 / 2, parameters.learn_rate))
    error = learn(network, situation)
    torch.testing.assert_close(error.double(), torch.tensor(errors).double(), atol=1e-5, rtol=0)
    for robot, after in enumerate(expected):
        for name, tensor in network.networks.tensors().items():
            torch.testing.assert_close(tensor[robot].double(), after[name], atol=1e-5, rtol=0)


@quick
@given(st.floats(0, 1), numbers, numbers)
def test_the_target_is_the_reward_and_the_discounted_value_of_the_selected_action(
    discount, reward, next_value
):
    before, now = Step(2, 1), Step(2, 1)
    now.record(torch.zeros(2, 1), torch.zeros(2, 3, 2), *fixed_choice(next_value))
    before.chained[0] = 1
    target, learning = TDTarget(discount)(torch.full((2,), reward), before, now)
    assert target.tolist() == pytest.approx([reward + discount * next_value] * 2, abs=1e-5)
    assert learning.tolist() == [1, 0]


def fixed_choice(value):
    """Values of three actions, of which the last is selected, and the indices of a step."""
    values = torch.tensor([[value + 1, value - 1, value]] * 2)
    return values, torch.tensor([2, 2]), torch.tensor([0, 0])


def test_the_target_is_not_differentiated():
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
    network.learn(state, action, 1 + parameters.discount * ahead, 1.0, parameters.learn_rate)
    for name, tensor in network.networks.tensors().items():
        torch.testing.assert_close(tensor[0].double(), semi[name], atol=1e-5, rtol=0)
    assert (semi["hidden_weights"] - full["hidden_weights"]).abs().max() > 1e-3


@quick
@given(situations(), st.data())
def test_a_robot_that_does_not_learn_keeps_its_weights_and_does_not_affect_others(situation, data):
    network = situation["network"]
    robots = len(situation["state"])
    mask = data.draw(st.lists(st.sampled_from([0.0, 1.0]), min_size=robots, max_size=robots))
    learning = torch.tensor(mask)
    before = {k: t.clone() for k, t in network.networks.tensors().items()}
    full_error = learn(network, situation)
    full = {k: t.clone() for k, t in network.networks.tensors().items()}
    load_into(network.networks.tensors(), before)
    error = learn(network, situation, learning)
    for robot in range(robots):
        source = full if learning[robot] else before
        for name, tensor in network.networks.tensors().items():
            assert torch.equal(tensor[robot], source[name][robot])
        assert error[robot] == (full_error[robot] if learning[robot] else 0)


@quick
@given(situations())
def test_a_robot_learns_the_same_alone_and_in_a_batch(situation):
    network = situation["network"]
    robots, sensors = situation["state"].shape
    alone = []
    for robot in range(robots):
        single = EvaluationNetwork(situation["parameters"], 1, sensors, torch.Generator())
        row = slice(robot, robot + 1)
        load_into(
            single.networks.tensors(), {k: t[row] for k, t in network.networks.tensors().items()}
        )
        own = {name: situation[name][row] for name in ("state", "action", "target")}
        learn(single, situation | own)
        alone.append(single)
    learn(network, situation)
    for robot, single in enumerate(alone):
        for name, tensor in network.networks.tensors().items():
            own = single.networks.tensors()[name][0]
            torch.testing.assert_close(tensor[robot], own, atol=1e-6, rtol=1e-6)
