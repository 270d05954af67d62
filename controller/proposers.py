"""Action proposers: the actions among which the evaluation network chooses (section 3)."""

from __future__ import annotations

import itertools
from typing import Protocol

import torch
from torch import Tensor

from .memory import CreativeMemory
from .parameters import PROPOSERS, Parameters


class ActionProposer(Protocol):
    """Anything that proposes A actions a robot."""

    def propose(self, state: Tensor) -> Tensor:
        """Motor values in [-0.5, 0.5], shape (B, A, 2), for states of shape (B, S)."""
        ...


class FixedActions:
    """All pairs of a few motor values, the same 25 actions for ever."""

    def __init__(self, motors: tuple[float, ...]) -> None:
        """Makes the pairs of these motor values."""
        self._actions = torch.tensor(list(itertools.product(motors, repeat=2)))

    def propose(self, state: Tensor) -> Tensor:
        """Motor values, shape (B, A, 2), for states of shape (B, S)."""
        return self._actions.expand(len(state), -1, -1)


class RandomActions:
    """Actions drawn uniformly from [-0.5, 0.5] squared, anew for every step and robot."""

    def __init__(self, count: int, generator: torch.Generator) -> None:
        """Prepares to draw `count` actions a robot."""
        self._count = count
        self._generator = generator

    def propose(self, state: Tensor) -> Tensor:
        """Motor values, shape (B, A, 2), for states of shape (B, S)."""
        return torch.rand(len(state), self._count, 2, generator=self._generator) - 0.5


class CreativeActions:
    """The ideas of a creative memory, and perhaps some from outside."""

    def __init__(self, memory: CreativeMemory, others: RandomActions | None = None) -> None:
        """Proposes what this memory's noise makes of its main idea, and then the others."""
        self._memory = memory
        self._others = others

    def propose(self, state: Tensor) -> Tensor:
        """Motor values, shape (B, A, 2), for states of shape (B, S)."""
        ideas = self._memory.ideas(state)
        if self._others is None:
            return ideas
        return torch.cat([ideas, self._others.propose(state)], dim=1)


def make_proposer(
    name: str, parameters: Parameters, memory: CreativeMemory | None, generator: torch.Generator
) -> ActionProposer:
    """Returns the proposer of that name; only "creative" needs the memory.

    Raises:
      ValueError: there is no such proposer.
    """
    if name == "fixed":
        return FixedActions(parameters.fixed_motors)
    if name == "random":
        return RandomActions(parameters.ideas, generator)
    if name == "creative" and memory is not None:
        others = parameters.random_ideas
        return CreativeActions(memory, RandomActions(others, generator) if others else None)
    raise ValueError(f"proposer must be one of {', '.join(PROPOSERS)}, got {name!r}")
