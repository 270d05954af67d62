"""Multilayer networks, one for each of B robots, their gradients, and Adam."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from itertools import pairwise

import torch
import torch.nn.functional as F
from torch import Tensor
from torch.optim.adam import adam

Hidden = Callable[[Tensor], Tensor]


class LayeredNetworks:
    """B fully connected networks of equal layer sizes; the last layer is linear.

    Attributes:
      flat: All W weights and biases of each robot, shape (B, W); they change in place.
      tensors: Weights (B, O, I) and biases (B, O) of each layer in turn, with I inputs and O
        outputs; views of `flat`.
    """

    def __init__(
        self,
        robots: int,
        sizes: Sequence[int],
        generator: torch.Generator,
        hidden: Hidden = F.leaky_relu,
        last_hidden: Hidden | None = None,
    ) -> None:
        """Draws weights from U(-1/sqrt(I), 1/sqrt(I)), as PyTorch does, and sets biases to 0.

        Args:
          robots: Number B of networks.
          sizes: Number of inputs, then of neurons of each hidden layer, then of outputs.
          generator: Random stream from which the initial weights are drawn.
          hidden: Activation function of the hidden layers.
          last_hidden: Activation function of the last hidden layer; None to use `hidden`.
        """
        self._hidden = [hidden] * (len(sizes) - 2)
        if self._hidden and last_hidden:
            self._hidden[-1] = last_hidden
        self._shapes = [shape for i, o in pairwise(sizes) for shape in ((o, i), (o,))]
        self._counts = [math.prod(shape) for shape in self._shapes]
        self.flat = torch.zeros(robots, sum(self._counts))
        self.tensors = self.views(self.flat)
        for weights in self.tensors[::2]:
            uniform = torch.rand(weights.shape, generator=generator) * 2 - 1
            weights.copy_(uniform / math.sqrt(weights.shape[-1]))

    def __call__(self, inputs: Tensor, flat: Tensor | None = None) -> Tensor:
        """Evaluates each robot's network.

        Args:
          inputs: One input vector per robot, shape (B, I), or N of them, shape (B, N, I).
          flat: Weights and biases to use, shape (B, W); None for the networks' own.

        Returns:
          Outputs, shape (B, O) or (B, N, O).
        """
        several = inputs.dim() == 3
        x = self.layers(inputs if several else inputs[:, None], flat)[-1]
        return x if several else x[:, 0]

    def layers(self, inputs: Tensor, flat: Tensor | None = None) -> list[Tensor]:
        """Returns the inputs, (B, N, I), and the activations of each layer, (B, N, O)."""
        tensors = self.tensors if flat is None else self.views(flat)
        found = [inputs]
        for layer, (weights, biases) in enumerate(zip(tensors[::2], tensors[1::2], strict=True)):
            x = torch.baddbmm(biases[:, None], found[-1], weights.mT)
            if layer < len(self._hidden):
                x = self._hidden[layer](x)
            found.append(x)
        return found

    def differentiated(self, objective: Callable[[Tensor], Tensor]) -> tuple[Tensor, Tensor]:
        """Returns each robot's objective, (B,), and its gradient, (B, W).

        The objective is a function of weights and biases, (B, W), that returns a number per robot.
        """
        with torch.enable_grad():
            leaf = self.flat.detach().requires_grad_()
            values = objective(leaf)
            gradient = torch.autograd.grad(values.sum(), leaf)[0]
        return values.detach(), gradient

    def relu_gradient(self, layers: list[Tensor], slopes: Tensor) -> Tensor:
        """Returns the gradient of an objective by backpropagation, if all hidden layers are ReLUs.

        It takes half the time of `differentiated`.

        Args:
          layers: Activations at N inputs, which `layers` returned.
          slopes: Derivative of each robot's objective with respect to outputs, shape (B, N, O).

        Returns:
          Derivative with respect to weights and biases, shape (B, W).
        """
        gradient = torch.empty_like(self.flat)
        parts = self.views(gradient)
        for layer in reversed(range(len(layers) - 1)):
            below = layers[layer]
            # Both are equal for N = 1, where torch.bmm takes several times as long.
            product = torch.mul if slopes.shape[1] == 1 else torch.bmm
            parts[2 * layer].mT.copy_(product(below.mT, slopes))
            parts[2 * layer + 1].copy_(slopes.sum(dim=1))
            if layer > 0:
                slopes = torch.bmm(slopes, self.tensors[2 * layer]) * (below > 0)
        return gradient

    def views(self, flat: Tensor) -> list[Tensor]:
        """Returns weights (B, O, I) and biases (B, O) of each layer, as views of `flat`, (B, W)."""
        parts = flat.split(self._counts, dim=1)
        # Weights of one input lie together: torch.bmm is then up to three times as fast.
        return [
            part.view(-1, *reversed(shape)).mT if len(shape) == 2 else part
            for part, shape in zip(parts, self._shapes, strict=True)
        ]


def normalised(x: Tensor) -> Tensor:
    """Normalises a layer's weighted sums to mean 0 and variance 1, then applies a leaky ReLU."""
    return F.leaky_relu(F.layer_norm(x, x.shape[-1:]))


def of_unit_length(x: Tensor) -> Tensor:
    """Applies a leaky ReLU to a layer's weighted sums, then scales the vector to length 1."""
    return F.normalize(F.leaky_relu(x), dim=-1)


class Adam:
    """PyTorch's Adam on the weights of B networks, with one learn rate, or one for each robot.

    Moments that have decayed to 1e-30 become 0: with numbers below 1e-38, a step takes nine times
    as long.

    Attributes:
      tensors: Number of steps so far, and the two moments, each (B, W).
    """

    SMALLEST, CLEARED = 1e-30, 50  # smallest moment kept; steps between two clearings

    def __init__(self, networks: LayeredNetworks, rate: float | Tensor, mean_decay: float) -> None:
        """Begins with moments of 0; each step multiplies the mean gradient by `mean_decay`."""
        self._networks, self._rate, self._mean_decay = networks, rate, mean_decay
        self.tensors = [torch.zeros(()), *(torch.zeros_like(networks.flat) for _ in range(2))]

    def descend(self, cost: Callable[[Tensor], Tensor]) -> None:
        """Makes a step down the gradient of a cost; see `LayeredNetworks.differentiated`."""
        self.step(self._networks.differentiated(cost)[1])

    def step(self, gradient: Tensor) -> None:
        """Makes a step down each robot's gradient, (B, W)."""
        steps, mean, square = self.tensors
        rate, weights = self._rate, self._networks.flat
        # Robots of different rates: PyTorch's step at rate 1, then each robot's share of it.
        differ = isinstance(rate, Tensor)
        moved = torch.zeros_like(weights) if differ else weights
        # PyTorch's function: its class takes twice the time for small networks.
        adam(
            [moved], [gradient], [mean], [square], [], [steps],
            lr=1.0 if differ else rate, beta1=self._mean_decay, beta2=0.999, eps=1e-8,
            weight_decay=0.0, amsgrad=False, maximize=False, fused=True,
        )  # fmt: skip
        if differ:
            weights.addcmul_(rate[:, None], moved)
        if steps % self.CLEARED == 0:
            for moment in (mean, square):
                moment.masked_fill_(moment.abs() < self.SMALLEST, 0.0)


def column(value: float | Tensor) -> float | Tensor:
    """Returns a number unchanged, and a tensor with one per robot, (B,), as a column (B, 1)."""
    return value[:, None] if isinstance(value, Tensor) else value
