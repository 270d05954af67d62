"""Selection: which robots explore, and with which action (section 2)."""

from __future__ import annotations

import math

import torch
from torch import Tensor


class EpsilonGreedy:
    """Explores with a proposed action drawn at random, for one step at a time (section 2)."""

    def __init__(self, generator: torch.Generator) -> None:
        """Takes the random stream of the draws."""
        self._generator = generator

    def draw(self, ideas: Tensor, epsilon: float | Tensor) -> tuple[Tensor, Tensor]:
        """Draws the robots that explore, and their actions.

        Args:
          ideas: Motor values of the proposed actions, shape (B, A, 2).
          epsilon: Probability that a greedy robot starts to explore in this step: a number, or a
            tensor of shape ().

        Returns:
          The actions, to which an exploratory one may be appended, shape (B, A or A + 1, 2); and
          the index of each robot's exploratory action, -1 for a greedy robot, shape (B,).
        """
        robots, count = ideas.shape[:2]
        drawn, uniform = self.numbers(robots, count, ideas.device)
        explores = uniform < epsilon
        return ideas, drawn.masked_fill_(~explores, -1)

    def numbers(self, robots: int, count: int, device: torch.device) -> tuple[Tensor, Tensor]:
        """Draws for each robot an action's index and a number in [0, 1), both of shape (B,)."""
        generator = self._generator
        drawn = torch.randint(count, (robots,), generator=generator, device=device)
        return drawn, torch.rand(robots, generator=generator, device=device)

    def tensors(self) -> dict[str, Tensor]:
        """Returns the tensors kept from step to step, for a checkpoint: none."""
        return {}


class PersistentExploration:
    """Beyond the paper: motor pairs drawn uniformly, each held for 1 to `longest` steps."""

    def __init__(self, robots: int, longest: int, generator: torch.Generator) -> None:
        """Starts with all robots greedy.

        Args:
          robots: Number B of robots.
          longest: Longest duration of an exploratory action, in control steps.
          generator: Random stream of the starts, motor pairs and durations of exploratory actions.
        """
        self._longest = longest
        self._generator = generator
        self._pair = torch.zeros(robots, 2)
        self._left = torch.zeros(robots, dtype=torch.int64)

    def draw(self, ideas: Tensor, epsilon: float | Tensor) -> tuple[Tensor, Tensor]:
        """Draws as `EpsilonGreedy.draw`, but an exploratory action goes on until its last step."""
        robots, count = ideas.shape[:2]
        generator, device = self._generator, ideas.device
        pairs = torch.rand(robots, 2, generator=generator, device=device) - 0.5
        longest = self._longest + 1
        lengths = torch.randint(1, longest, (robots,), generator=generator, device=device)
        starts = torch.rand(robots, generator=generator, device=device) < epsilon
        starts &= self._left == 0
        torch.where(starts[:, None], pairs, self._pair, out=self._pair)
        torch.where(starts, lengths, self._left, out=self._left)
        explores = self._left > 0
        self._left -= explores.long()
        actions = torch.cat([ideas, self._pair[:, None]], dim=1)
        return actions, explores * (count + 1) - 1  # the index `count`, or -1

    def tensors(self) -> dict[str, Tensor]:
        """Returns the motor pairs and their remaining steps, for a checkpoint."""
        return {"pair": self._pair, "left": self._left}


Exploration = EpsilonGreedy | PersistentExploration


class Schedule:
    """Epsilon or the learn rate: constant, or, beyond the paper, with an exponential decay.

    Attributes:
      value: Value in the present step: a number, or, if it decays on a GPU, a tensor of shape ().
        The tensor is changed in place, so that steps captured as CUDA graphs read the new value.
    """

    value: float | Tensor

    def __init__(self, final: float, initial: float | None, steps: float) -> None:
        """Takes the final value, the initial one, and the time constant in steps of training.

        Without an initial value, the final one holds in all steps.
        """
        self._initial, self._final, self._steps = initial, final, steps
        self.value = final
        if initial is not None and torch.get_default_device().type != "cpu":
            self.value = torch.full((), float(initial))

    def update(self, age: int) -> None:
        """Sets `value` to that after `age` steps of training."""
        if self._initial is None:
            return
        left = math.exp(-age / self._steps)
        value = self._final + (self._initial - self._final) * left
        self.value = self.value.fill_(value) if isinstance(self.value, Tensor) else value
