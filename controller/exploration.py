"""How a learning robot strays from the best action: for a step, or on a walk of several."""

from __future__ import annotations

from typing import Protocol

import torch
from torch import Tensor

from .parameters import Parameters


class Exploration(Protocol):
    """Anything that leads robots astray."""

    def stray(self, actions: Tensor, epsilon: float) -> tuple[Tensor, Tensor]:
        """Decides who strays, and where to.

        Args:
          actions: proposed, shape (B, A, 2).
          epsilon: probability that a robot begins to stray.

        Returns:
          The actions, perhaps with one more at the end, shape (B, A or A + 1, 2); and which of
          them each robot takes that strays, an index, -1 for who does not, shape (B,).
        """
        ...

    def tensors(self) -> dict[str, Tensor]:
        """What it remembers from step to step, for a checkpoint."""
        ...


class OneStep:
    """Epsilon-greedy as in section 2: any of the proposed actions, for one step."""

    def __init__(self, generator: torch.Generator) -> None:
        """Takes the random stream to draw from."""
        self._generator = generator

    def stray(self, actions: Tensor, epsilon: float) -> tuple[Tensor, Tensor]:
        """See `Exploration.stray`."""
        size = actions.shape[:1]
        anything = torch.randint(actions.shape[1], size, generator=self._generator)
        astray = torch.rand(size, generator=self._generator) < epsilon
        return actions, torch.where(astray, anything, -1)

    def tensors(self) -> dict[str, Tensor]:
        """Nothing."""
        return {}


class HeldPair:
    """Any motor pair, held for 1 to `longest` steps: a walk that leads somewhere."""

    def __init__(self, robots: int, longest: int, generator: torch.Generator) -> None:
        """Nobody strays yet."""
        self._longest = longest
        self._generator = generator
        self._pair = torch.zeros(robots, 2)
        self._left = torch.zeros(robots, dtype=torch.int64)

    def stray(self, actions: Tensor, epsilon: float) -> tuple[Tensor, Tensor]:
        """See `Exploration.stray`; who strays goes on until its steps are over."""
        robots, count = actions.shape[:2]
        pairs = torch.rand(robots, 2, generator=self._generator) - 0.5
        lengths = torch.randint(1, self._longest + 1, (robots,), generator=self._generator)
        begin = torch.rand(robots, generator=self._generator) < epsilon
        begin &= self._left == 0
        self._pair.copy_(torch.where(begin[:, None], pairs, self._pair))
        self._left.copy_(torch.where(begin, lengths, self._left))
        astray = self._left > 0
        self._left -= astray.long()
        return torch.cat([actions, self._pair[:, None]], dim=1), torch.where(astray, count, -1)

    def tensors(self) -> dict[str, Tensor]:
        """The pairs, and for how many steps more they are held."""
        return {"pair": self._pair, "left": self._left}


def make_exploration(
    parameters: Parameters, robots: int, generator: torch.Generator
) -> Exploration:
    """Returns the exploration that the parameters ask for."""
    if parameters.held_steps:
        return HeldPair(robots, parameters.held_steps, generator)
    return OneStep(generator)
