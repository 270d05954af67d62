"""How weights follow a gradient: by a step along it, as in the paper, or as Adam goes."""

from __future__ import annotations

from typing import Literal, Protocol

import torch
from torch import Tensor

from .networks import Networks

OptimizerName = Literal["plain", "adam"]


class Optimizer(Protocol):
    """Anything that moves the weights of B networks up a gradient."""

    def ascend(
        self, inputs: Tensor, hidden: Tensor, steps: Tensor, rate: float, learning: Tensor | float
    ) -> None:
        """Moves every robot's weights along the gradient of its output sums.

        Args:
          inputs: where the networks were evaluated, shape (B, I).
          hidden: their hidden activations there, shape (B, H).
          steps: the errors of the output sums, shape (B, O); 0 for robots that do not learn.
          rate: the learn rate.
          learning: 1 for a robot that learns, 0 for one that does not, shape (B,).
        """
        ...

    def tensors(self) -> dict[str, Tensor]:
        """What it remembers from step to step, for a checkpoint."""
        ...


class Plain:
    """The gradient times the learn rate, as in Eq. 1."""

    def __init__(self, networks: Networks) -> None:
        """Takes the networks to move."""
        self._networks = networks

    def ascend(
        self, inputs: Tensor, hidden: Tensor, steps: Tensor, rate: float, learning: Tensor | float
    ) -> None:
        """See `Optimizer.ascend`."""
        del learning  # steps of 0 change nothing
        self._networks.ascend(inputs, hidden, rate * steps)

    def tensors(self) -> dict[str, Tensor]:
        """Nothing."""
        return {}


class Adam:
    """Adam (Kingma and Ba, ICLR 2015), for every robot with moments of its own."""

    MEAN_DECAY = 0.9
    SQUARE_DECAY = 0.999
    EPSILON = 1e-8

    def __init__(self, networks: Networks) -> None:
        """Takes the networks to move."""
        self._networks = networks
        weights = torch.cat([tensor.flatten(1) for tensor in networks.tensors().values()], dim=1)
        self._mean = torch.zeros_like(weights)
        self._square = torch.zeros_like(weights)
        self._steps = torch.zeros(len(weights), 1)

    def ascend(
        self, inputs: Tensor, hidden: Tensor, steps: Tensor, rate: float, learning: Tensor | float
    ) -> None:
        """See `Optimizer.ascend`."""
        gradient = self._networks.gradient(inputs, hidden, steps)
        on = torch.as_tensor(learning).expand(len(gradient))[:, None]
        self._steps += on
        self._mean += (1 - self.MEAN_DECAY) * on * (gradient - self._mean)
        self._square += (1 - self.SQUARE_DECAY) * on * (gradient.square_() - self._square)
        # Both begin at zero, which the powers make up for.
        count = self._steps.clamp(min=1)
        rates = rate * on / (1 - self.MEAN_DECAY**count)
        root = (self._square / (1 - self.SQUARE_DECAY**count)).sqrt_()
        self._networks.add(rates * self._mean / root.add_(self.EPSILON))

    def tensors(self) -> dict[str, Tensor]:
        """The moments, and how often each robot has learnt."""
        return {"mean": self._mean, "square": self._square, "steps": self._steps}


def make_optimizer(name: OptimizerName, networks: Networks) -> Optimizer:
    """Returns the optimizer of that name."""
    return Adam(networks) if name == "adam" else Plain(networks)
