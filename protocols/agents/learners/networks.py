"""Networks with several layers, one for each of B robots, and their gradients by autograd."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

import torch
import torch.nn.functional as F
from torch import Tensor

Hidden = Callable[[Tensor], Tensor]


class LayeredNetworks:
    """B fully connected networks of equal shape; the last layer is linear.

    Attributes:
      tensors: Weights (B, O, I) and biases (B, O) of each layer in turn.
    """

    def __init__(
        self,
        robots: int,
        sizes: Sequence[int],
        generator: torch.Generator,
        hidden: Hidden = F.leaky_relu,
        last_hidden: Hidden | None = None,
    ) -> None:
        """Draws weights from U(-1/sqrt(I), 1/sqrt(I)), as PyTorch does; biases are 0.

        Args:
          robots: Number B of networks.
          sizes: Numbers of inputs, of neurons of each hidden layer, and of outputs.
          generator: Random stream.
          hidden: Function of the sums of a hidden layer.
          last_hidden: Function of the sums of the last hidden layer; None for `hidden`.
        """
        self._hidden = [hidden] * (len(sizes) - 3) + [last_hidden or hidden]
        self.tensors: list[Tensor] = []
        for fan_in, fan_out in zip(sizes, sizes[1:], strict=False):
            uniform = torch.rand(robots, fan_out, fan_in, generator=generator) * 2 - 1
            self.tensors += [uniform / math.sqrt(fan_in), torch.zeros(robots, fan_out)]

    def __call__(self, inputs: Tensor, tensors: Sequence[Tensor] | None = None) -> Tensor:
        """Evaluates each robot's network.

        Args:
          inputs: Inputs, shape (B, I), or (B, N, I) for N inputs a robot.
          tensors: Weights and biases in place of the networks' own.

        Returns:
          Outputs, shape (B, O) or (B, N, O).
        """
        tensors = self.tensors if tensors is None else tensors
        several = inputs.dim() == 3
        x = inputs if several else inputs[:, None]
        for layer, (weights, biases) in enumerate(zip(tensors[::2], tensors[1::2], strict=True)):
            x = torch.baddbmm(biases[:, None], x, weights.mT)
            if layer < len(self._hidden):
                x = self._hidden[layer](x)
        return x if several else x[:, 0]

    def gradients(self, objective: Callable[[Sequence[Tensor]], Tensor]) -> list[Tensor]:
        """Returns the gradient of each robot's objective with respect to its own weights.

        Args:
          objective: Function of weights and biases that returns one number a robot, shape (B,).
        """
        with torch.enable_grad():
            leaves = [tensor.detach().requires_grad_() for tensor in self.tensors]
            return [*torch.autograd.grad(objective(leaves).sum(), leaves)]


def normalised(x: Tensor) -> Tensor:
    """Returns a layer's sums with mean 0 and variance 1 in each robot, then leaky rectified."""
    return F.leaky_relu(F.layer_norm(x, x.shape[-1:]))


def of_unit_length(x: Tensor) -> Tensor:
    """Returns leaky rectified sums of a layer, scaled to a vector of length 1."""
    x = F.leaky_relu(x)
    return x / x.norm(dim=-1, keepdim=True).clamp(min=1e-12)


def adam(tensors: Sequence[Tensor], rate: float, mean_decay: float = 0.9) -> torch.optim.Adam:
    """Returns PyTorch's Adam, whose moments exist already, so that checkpoints can hold them."""
    optimizer = torch.optim.Adam(tensors, lr=rate, betas=(mean_decay, 0.999))
    for tensor in tensors:
        optimizer.state[tensor] = {
            "step": torch.zeros(()),
            "exp_avg": torch.zeros_like(tensor),
            "exp_avg_sq": torch.zeros_like(tensor),
        }
    return optimizer


def moments(optimizer: torch.optim.Adam) -> list[Tensor]:
    """Returns all that an optimizer of `adam` keeps from step to step."""
    tensors = optimizer.param_groups[0]["params"]
    return [kept for tensor in tensors for kept in optimizer.state[tensor].values()]


def descend(optimizer: torch.optim.Adam, gradients: Sequence[Tensor]) -> None:
    """Makes a step of an optimizer of `adam` against the given gradients."""
    for tensor, gradient in zip(optimizer.param_groups[0]["params"], gradients, strict=True):
        tensor.grad = gradient
    optimizer.step()
