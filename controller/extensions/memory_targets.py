"""What the creative memory learns instead of the selected action."""

from __future__ import annotations

from torch import Tensor

from ..optimizers import Rate
from ..step import Step


def best_action(
    before: Step, error: Tensor, learning: Tensor, rate: Rate
) -> tuple[Tensor, Tensor, Rate]:
    """Returns the best proposed action as target, at the learn rate of the evaluation network.

    Args:
      before: Step at time t.
      error: TD error of the step, shape (B,).
      learning: 1 for a robot that learns, 0 for one that does not, shape (B,).
      rate: Learn rate of the evaluation network.
    """
    del error
    return before.best_action, learning, rate
