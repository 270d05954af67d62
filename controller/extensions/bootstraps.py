"""Other values of the next step in the target: the maximum of Q-learning, the clipped value."""

from __future__ import annotations

from collections.abc import Callable

import torch
from torch import Tensor

from ..step import Step


def max_value(before: Step, now: Step) -> Tensor:
    """Returns V at t + 1 of Q-learning, the value of the best proposed action, shape (B,).

    Args:
      before: Step at time t.
      now: Step at time t + 1.
    """
    del before
    return now.best_value


class ClippedBootstrap:
    """V at t + 1, clipped to max(r(t), 0) if the reward fell to 0 or below in this step.

    It needs the rewards that `RememberedReward` keeps.
    """

    def __init__(self, next_value: Callable[[Step, Step], Tensor]) -> None:
        """Takes the function that returns V at t + 1."""
        self._next_value = next_value

    def __call__(self, before: Step, now: Step) -> Tensor:
        """Returns the clipped values, shape (B,)."""
        value = self._next_value(before, now)
        lost = (now.reward < before.reward) & (now.reward <= 0)
        return torch.where(lost, torch.minimum(value, before.reward.clamp(min=0)), value)
