"""The limited TD error against the Huber loss."""

import pytest
import torch

from musebot.controller import EvaluationNetwork, Parameters
from musebot.controller.extensions.td_error import LimitedTDError


@pytest.mark.parametrize("limit", [0.01, 0.3, 3.0])
def test_learning_is_gradient_descent_on_the_huber_loss(limit, double_precision):
    generator = torch.Generator().manual_seed(1)
    parameters = Parameters(learn_rate=0.1)
    error = LimitedTDError(limit)
    network = EvaluationNetwork(parameters, 20, 3, generator, td_error=error)
    state = torch.rand(20, 3, generator=generator)
    action = torch.rand(20, 2, generator=generator) - 0.5
    target = torch.rand(20, generator=generator) * 4 - 2
    w = {name: t.clone().requires_grad_() for name, t in network.networks.tensors().items()}
    x = torch.cat([state, action], dim=1)[..., None]
    hidden = torch.sigmoid(w["hidden_weights"] @ x + w["hidden_biases"][..., None])
    value = (w["output_weights"] @ hidden)[..., 0] + w["output_biases"]
    loss = torch.nn.functional.huber_loss(value[:, 0], target, reduction="sum", delta=limit)
    loss.backward()
    errors = network.learn(state, action, target, 1.0, 0.1)
    expected = (target - value[:, 0].detach()).clamp(-limit, limit)
    torch.testing.assert_close(errors, expected, atol=1e-12, rtol=0)
    for name, tensor in network.networks.tensors().items():
        after = (w[name] - 0.1 * w[name].grad).detach()
        torch.testing.assert_close(tensor, after, atol=1e-12, rtol=0)


def test_a_robot_that_does_not_learn_has_no_error():
    error = LimitedTDError(0.1)
    learning = torch.tensor([1.0, 0.0])
    assert error(torch.tensor([5.0, 5.0]), torch.zeros(2), learning).tolist() == [
        pytest.approx(0.1),
        0.0,
    ]
