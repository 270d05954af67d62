"""End of a robot's training after some time at maximal smell (suggested in section 4)."""

from __future__ import annotations

import torch
from torch import Tensor

from ..evaluation_network import Target
from ..exploration import Exploration
from ..step import Step


class StoppingRule:
    """Stops the training of robots that stay at maximal smell."""

    def __init__(self, robots: int, steps: int, maximal: float) -> None:
        """Starts with all robots in training.

        Args:
          robots: Number B of robots.
          steps: Number of training steps in a row at maximal smell after which training stops.
          maximal: Reward signal at maximal smell; infinity if the reward does not saturate.
        """
        self._limit = steps
        self._maximal = torch.tensor(maximal)
        # Count of steps in a row at maximal smell; after the stop, every step is counted.
        self._steps = torch.zeros(robots, dtype=torch.int64)

    def stopped(self) -> Tensor:
        """Returns whether each robot's training has stopped, shape (B,)."""
        return self._steps >= self._limit

    def update(self, reward: Tensor) -> None:
        """Counts a step with these reward signals, shape (B,)."""
        continues = (reward >= self._maximal) | self.stopped()
        self._steps.copy_((self._steps + 1) * continues)

    def tensors(self) -> dict[str, Tensor]:
        """Returns the counted steps, for a checkpoint."""
        return {"steps_at_maximum": self._steps}


class StoppingTarget:
    """A target for robots in training only: a robot whose training has stopped learns nothing."""

    def __init__(self, target: Target, rule: StoppingRule) -> None:
        """Takes the target of robots in training."""
        self._target = target
        self._rule = rule

    def __call__(self, reward: Tensor, before: Step, now: Step) -> tuple[Tensor, Tensor]:
        """See `Target.__call__`."""
        target, learning = self._target(reward, before, now)
        self._rule.update(reward)
        return target, learning * ~self._rule.stopped()


class StoppingExploration:
    """An exploration for robots in training only: other robots do not explore."""

    def __init__(self, exploration: Exploration, rule: StoppingRule) -> None:
        """Takes the exploration of robots in training."""
        self._exploration = exploration
        self._rule = rule

    def draw(self, ideas: Tensor, epsilon: float | Tensor) -> tuple[Tensor, Tensor]:
        """See `Exploration.draw`."""
        actions, exploratory = self._exploration.draw(ideas, epsilon)
        return actions, exploratory.masked_fill(self._rule.stopped(), -1)

    def tensors(self) -> dict[str, Tensor]:
        """Returns the tensors of the exploration and of the rule, for a checkpoint."""
        return self._exploration.tensors() | self._rule.tensors()
