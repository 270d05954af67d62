"""How weights follow a gradient: Adam against torch's own, for every robot by itself."""

import pytest
import torch

from musebot.controller.networks import Networks
from musebot.controller.optimizers import Adam, make_optimizer

ROBOTS, INPUTS, HIDDEN, OUTPUTS = 4, 3, 5, 2


@pytest.fixture(autouse=True)
def double_precision():
    torch.set_default_dtype(torch.float64)
    yield
    torch.set_default_dtype(torch.float32)


def born(seed=1, robots=ROBOTS):
    generator = torch.Generator().manual_seed(seed)
    return Networks(robots, INPUTS, HIDDEN, OUTPUTS, 1.0, generator, "tanh")


def lessons(count, seed=2):
    """Inputs and errors, and who learns in each step: none of the robots always."""
    generator = torch.Generator().manual_seed(seed)
    for _ in range(count):
        inputs = torch.rand(ROBOTS, INPUTS, generator=generator) * 2 - 1
        steps = torch.rand(ROBOTS, OUTPUTS, generator=generator) * 2 - 1
        learning = (torch.rand(ROBOTS, generator=generator) < 0.7).double()
        yield inputs, steps * learning[:, None], learning


def teach(networks, optimizer, rate, count=40):
    for inputs, steps, learning in lessons(count):
        hidden, _ = networks.forward(inputs)
        optimizer.ascend(inputs, hidden, steps, rate, learning)


def test_adam_goes_where_torchs_adam_goes_and_rests_with_a_robot_that_does_not_learn():
    networks = born()
    twins = [{k: t[r].clone().requires_grad_() for k, t in networks.tensors().items()} for r in
             range(ROBOTS)]  # fmt: skip
    torchs = [torch.optim.Adam(twin.values(), lr=0.01) for twin in twins]
    teach(networks, Adam(networks), 0.01)
    for inputs, steps, learning in lessons(40):
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
    networks = born()
    before = {name: tensor.clone() for name, tensor in networks.tensors().items()}
    optimizer = Adam(networks)
    for inputs, steps, _ in lessons(5):
        hidden, _ = networks.forward(inputs)
        learning = torch.tensor([1.0, 0.0, 1.0, 0.0])
        optimizer.ascend(inputs, hidden, steps * learning[:, None], 0.01, learning)
    for name, tensor in networks.tensors().items():
        assert torch.equal(tensor[[1, 3]], before[name][[1, 3]])
        assert not torch.equal(tensor[[0, 2]], before[name][[0, 2]])


def test_adam_goes_on_from_its_tensors():
    whole, halves = born(), born()
    teach(whole, Adam(whole), 0.01, 40)
    first, second = Adam(halves), Adam(halves)
    for number, (inputs, steps, learning) in enumerate(lessons(40)):
        if number == 20:
            for name, tensor in second.tensors().items():
                tensor.copy_(first.tensors()[name])
        optimizer = first if number < 20 else second
        optimizer.ascend(inputs, halves.forward(inputs)[0], steps, 0.01, learning)
    for name, tensor in halves.tensors().items():
        assert torch.equal(tensor, whole.tensors()[name])


def test_plain_steps_are_the_gradient_times_the_learn_rate():
    networks, other = born(), born()
    inputs, steps, learning = next(lessons(1))
    hidden, _ = networks.forward(inputs)
    make_optimizer("plain", networks).ascend(inputs, hidden, steps, 0.3, learning)
    other.add(0.3 * other.gradient(inputs, hidden, steps))
    for name, tensor in networks.tensors().items():
        torch.testing.assert_close(tensor, other.tensors()[name], atol=1e-12, rtol=0)
