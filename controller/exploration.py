"""Exploration during training: epsilon-greedy selection (section 2)."""

from __future__ import annotations

from typing import Protocol

import torch
from torch import Tensor


class Exploration(Protocol):
    """Draws exploratory actions."""

    def draw(self, ideas: Tensor, epsilon: float | Tensor) -> tuple[Tensor, Tensor]:
        """Draws the robots that explore, and their actions.

        Args:
          ideas: Motor values of the proposed actions, shape (B, A, 2).
          epsilon: Probability that a greedy robot starts to explore.

        Returns:
          The actions, to which an exploratory one may be appended, shape (B, A or A + 1, 2); and
          the index of each robot's exploratory action, -1 for a greedy robot, shape (B,).
        """
        ...

    def tensors(self) -> dict[str, Tensor]:
        """Returns the tensors kept from step to step, for a checkpoint."""
        ...


class EpsilonGreedy:
    """Explores with a random one of the proposed actions, for one step at a time (section 2)."""

    def __init__(self, generator: torch.Generator) -> None:
        """Takes the random stream of the draws."""
        self._generator = generator

    def draw(self, ideas: Tensor, epsilon: float | Tensor) -> tuple[Tensor, Tensor]:
        """See `Exploration.draw`."""
        size = ideas.shape[:1]
        device, generator = ideas.device, self._generator
        drawn = torch.randint(ideas.shape[1], size, generator=generator, device=device)
        explores = torch.rand(size, generator=generator, device=device) < epsilon
        return ideas, drawn.masked_fill_(~explores, -1)

    def tensors(self) -> dict[str, Tensor]:
        """Returns no tensors."""
        return {}
