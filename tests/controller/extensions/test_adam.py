"""Adam against torch's own, for each robot separately."""

import pytest
import torch

from musebot.controller import CreativeMemory, Networks, Neurocontroller, Parameters
from musebot.controller.extensions.adam import Adam
from musebot.controller.networks import ACTIVATIONS

ROBOTS, INPUTS, HIDDEN, OUTPUTS = 4, 3, 5, 2
pytestmark = pytest.mark.usefixtures("double_precision")


def initial(seed=1):
    generator = torch.Generator().manual_seed(seed)
    networks = Networks(ROBOTS, INPUTS, HIDDEN, OUTPUTS, 1.0, generator)
    networks.activation = ACTIVATIONS["tanh"]
    return networks


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


def test_a_robot_that_never_learns_keeps_its_weights():
    networks = initial()
    before = {name: tensor.clone() for name, tensor in networks.tensors().items()}
    optimizer = Adam(networks)
    for inputs, steps, _ in updates(5):
        hidden, _ = networks.forward(inputs)
        learning = torch.tensor([1.0, 0.0, 1.0, 0.0])
        optimizer.ascend(inputs, hidden, steps * learning[:, None], 0.01, learning)
    for name, tensor in networks.tensors().items():
        assert torch.equal(tensor[[1, 3]], before[name][[1, 3]])
        assert not torch.equal(tensor[[0, 2]], before[name][[0, 2]])


def test_adam_continues_from_its_tensors():
    whole, halves = initial(), initial()
    train(whole, Adam(whole), 0.01, 40)
    first, second = Adam(halves), Adam(halves)
    for number, (inputs, steps, learning) in enumerate(updates(40)):
        if number == 20:
            for name, tensor in second.tensors().items():
                tensor.copy_(first.tensors()[name])
        optimizer = first if number < 20 else second
        optimizer.ascend(inputs, halves.forward(inputs)[0], steps, 0.01, learning)
    for name, tensor in halves.tensors().items():
        assert torch.equal(tensor, whole.tensors()[name])


def memory_of(**fields) -> CreativeMemory:
    memory = Neurocontroller(Parameters(**fields), "creative", ROBOTS, INPUTS, 1).memory
    assert memory is not None
    return memory


def test_a_memory_that_learns_at_the_td_error_follows_the_plain_gradient():
    plain, adam = memory_of(optimizer="sgd"), memory_of(optimizer="adam")
    state = torch.rand(ROBOTS, INPUTS, generator=torch.Generator().manual_seed(3))
    for memory in (plain, adam):
        rates = torch.tensor([0.01, -0.02, 0.0, 0.03])
        memory.learn(state, torch.full((ROBOTS, 2), 0.3), rates)
    for name, tensor in plain.networks.tensors().items():
        assert torch.equal(tensor, adam.networks.tensors()[name])
