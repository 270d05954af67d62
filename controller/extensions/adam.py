"""The Adam optimizer."""

from __future__ import annotations

import torch
from torch import Tensor

from ..networks import Networks
from ..optimizers import Rate


class Adam:
    """Adam (Kingma and Ba, ICLR 2015), with separate moments for each robot."""

    MEAN_DECAY = 0.9
    SQUARE_DECAY = 0.999
    EPSILON = 1e-8

    def __init__(self, networks: Networks) -> None:
        """Optimizes these networks."""
        self._networks = networks
        weights = torch.cat([tensor.flatten(1) for tensor in networks.tensors().values()], dim=1)
        self._mean = torch.zeros_like(weights)
        self._square = torch.zeros_like(weights)
        self._steps = torch.zeros(len(weights), 1)

    def ascend(
        self, inputs: Tensor, hidden: Tensor, steps: Tensor, rate: Rate, learning: Tensor
    ) -> None:
        """See `Optimizer.ascend`."""
        gradient = self._networks.gradient(inputs, hidden, steps)
        on = learning[:, None]
        self._steps += on
        self._mean += (1 - self.MEAN_DECAY) * on * (gradient - self._mean)
        self._square += (1 - self.SQUARE_DECAY) * on * (gradient.square_() - self._square)
        # Both moments start at zero; the powers correct this bias.
        count = self._steps.clamp(min=1)
        rates = rate * on / (1 - self.MEAN_DECAY**count)
        root = (self._square / (1 - self.SQUARE_DECAY**count)).sqrt_()
        self._networks.add(rates * self._mean / root.add_(self.EPSILON))

    def tensors(self) -> dict[str, Tensor]:
        """Returns the moments, and each robot's number of updates, for a checkpoint."""
        return {"mean": self._mean, "square": self._square, "steps": self._steps}
