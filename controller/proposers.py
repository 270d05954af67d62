"""Action proposers: the actions among which the evaluation network selects (section 3)."""

from __future__ import annotations

import itertools
from typing import Literal, Protocol, get_args

import torch
from torch import Tensor

from .creative_memory import Memory

Proposer = Literal["fixed", "random", "creative"]
PROPOSERS: tuple[Proposer, ...] = get_args(Proposer)


class ActionProposer(Protocol):
    """Proposes A actions to each robot."""

    def renew(self) -> None:
        """Draws what several steps share, if it is time; to be called before `propose`."""

    def propose(self, state: Tensor) -> Tensor:
        """Returns motor values in [-0.5, 0.5], shape (B, A, 2).

        Args:
          state: Network inputs, shape (B, I).
        """
        ...


class FixedActions(ActionProposer):
    """Proposes all pairs of some motor values in every step."""

    def __init__(self, motors: tuple[float, ...]) -> None:
        """Forms the pairs of these motor values."""
        pairs = list(itertools.product(motors, repeat=2))
        self._actions = torch.tensor(pairs, dtype=torch.float32)

    def propose(self, state: Tensor) -> Tensor:
        """See `ActionProposer.propose`."""
        return self._actions.expand(len(state), -1, -1)


class RandomActions(ActionProposer):
    """Proposes actions drawn uniformly from [-0.5, 0.5] x [-0.5, 0.5] in every step."""

    def __init__(self, count: int, generator: torch.Generator) -> None:
        """Takes the number of actions per robot, and the random stream of the draws."""
        self._count = count
        self._generator = generator

    def propose(self, state: Tensor) -> Tensor:
        """See `ActionProposer.propose`."""
        size = len(state), self._count, 2
        return torch.rand(size, generator=self._generator, device=state.device) - 0.5


class CreativeActions(ActionProposer):
    """Proposes the ideas of a creative memory."""

    def __init__(self, memory: Memory, count: int) -> None:
        """Takes the memory, and the number of ideas per robot."""
        self._memory = memory
        self._count = count

    def renew(self) -> None:
        """See `ActionProposer.renew`."""
        self._memory.renew()

    def propose(self, state: Tensor) -> Tensor:
        """See `ActionProposer.propose`."""
        return self._memory.ideas(state, self._count)
