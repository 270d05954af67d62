"""How the weights follow a gradient: the plain gradient step of Eq. 1."""

from __future__ import annotations

from typing import Protocol

from torch import Tensor

from .networks import Networks

Rate = float | Tensor  # a learn rate; a tensor of shape () where a captured step reads it


class Optimizer(Protocol):
    """Moves the weights of B networks along a gradient."""

    def ascend(
        self, inputs: Tensor, hidden: Tensor, steps: Tensor, rate: Rate, learning: Tensor
    ) -> None:
        """Moves the weights of every robot along the gradient of its output sums.

        Args:
          inputs: Network inputs, shape (B, I).
          hidden: Hidden activations at these inputs, shape (B, H).
          steps: Errors of the output sums, shape (B, O); 0 for robots that do not learn.
          rate: Learn rate.
          learning: 1 for a robot that learns, 0 for one that does not, shape (B,).
        """
        ...

    def tensors(self) -> dict[str, Tensor]:
        """Returns the tensors kept from step to step, for a checkpoint."""
        ...


class SGD:
    """Plain gradient steps: the gradient times the learn rate (Eq. 1)."""

    def __init__(self, networks: Networks) -> None:
        """Optimizes these networks."""
        self._networks = networks

    def ascend(
        self, inputs: Tensor, hidden: Tensor, steps: Tensor, rate: Rate, learning: Tensor
    ) -> None:
        """See `Optimizer.ascend`."""
        del learning  # steps of 0 change no weight
        self._networks.ascend(inputs, hidden, rate * steps)

    def tensors(self) -> dict[str, Tensor]:
        """Returns no tensors."""
        return {}
