"""Action proposers: the actions among which the evaluation network selects (section 3)."""

from __future__ import annotations

import itertools

import torch
from torch import Tensor

from .creative_memory import CreativeMemory
from .parameters import PROPOSERS as PROPOSERS


class FixedActions:
    """Proposes all pairs of some motor values in every step."""

    def __init__(self, motors: tuple[float, ...]) -> None:
        """Forms the pairs of these motor values."""
        pairs = list(itertools.product(motors, repeat=2))
        self._actions = torch.tensor(pairs, dtype=torch.get_default_dtype())

    def propose(self, state: Tensor) -> Tensor:
        """Returns motor values in [-0.5, 0.5], shape (B, A, 2).

        Args:
          state: Network inputs, shape (B, I).
        """
        return self._actions.expand(len(state), -1, -1)


class RandomActions:
    """Proposes actions drawn uniformly from [-0.5, 0.5] x [-0.5, 0.5] in every step."""

    def __init__(self, count: int, generator: torch.Generator) -> None:
        """Takes the number of actions per robot, and the random stream of the draws."""
        self._count = count
        self._generator = generator

    def propose(self, state: Tensor) -> Tensor:
        """Draws actions for each robot."""
        size = len(state), self._count, 2
        return torch.rand(size, generator=self._generator, device=state.device) - 0.5


class CreativeActions:
    """Proposes the ideas of a creative memory; beyond the paper, random actions follow them."""

    def __init__(self, memory: CreativeMemory, count: int, others: RandomActions | None) -> None:
        """Takes the memory, its number of ideas per robot, and the source of random actions."""
        self._memory = memory
        self._count = count
        self._others = others

    def propose(self, state: Tensor) -> Tensor:
        """Returns the memory's ideas, then the random actions."""
        ideas = self._memory.ideas(state, self._count)
        if self._others is None:
            return ideas
        return torch.cat([ideas, self._others.propose(state)], dim=1)


ActionProposer = FixedActions | RandomActions | CreativeActions
