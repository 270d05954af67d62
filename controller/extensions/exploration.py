"""Persistent exploration: a random motor pair, held for several steps."""

from __future__ import annotations

import torch
from torch import Tensor


class PersistentExploration:
    """Explores with motor pairs drawn uniformly, each held for 1 to `longest` steps."""

    def __init__(self, robots: int, longest: int, generator: torch.Generator) -> None:
        """Starts with greedy robots.

        Args:
          robots: Number B of robots.
          longest: Longest duration of an exploratory action, in control steps.
          generator: Random stream of the draws.
        """
        self._longest = longest
        self._generator = generator
        self._pair = torch.zeros(robots, 2)
        self._left = torch.zeros(robots, dtype=torch.int64)

    def draw(self, ideas: Tensor, epsilon: float | Tensor) -> tuple[Tensor, Tensor]:
        """See `Exploration.draw`; a robot that explores continues until its steps are over."""
        robots, count = ideas.shape[:2]
        generator, device = self._generator, ideas.device
        pairs = torch.rand(robots, 2, generator=generator, device=device) - 0.5
        longest = self._longest + 1
        lengths = torch.randint(1, longest, (robots,), generator=generator, device=device)
        starts = torch.rand(robots, generator=generator, device=device) < epsilon
        starts &= self._left == 0
        self._pair.copy_(torch.where(starts[:, None], pairs, self._pair))
        self._left.copy_(torch.where(starts, lengths, self._left))
        explores = self._left > 0
        self._left -= explores.long()
        actions = torch.cat([ideas, self._pair[:, None]], dim=1)
        return actions, explores * (count + 1) - 1  # the index `count`, or -1

    def tensors(self) -> dict[str, Tensor]:
        """Returns the motor pairs and their remaining steps, for a checkpoint."""
        return {"pair": self._pair, "left": self._left}
