"""One control step as the brain remembers it until it has learned from it (section 2)."""

from __future__ import annotations

from typing import ClassVar

import torch
from torch import Tensor


class Step:
    """What B robots sensed and selected in one control step.

    A step can be recorded again and again. Until its first recording, no next step
    continues it. The last four attributes exist only in a `DetailedStep`, for parts beyond the
    paper.

    Attributes:
      state: Network inputs, shape (B, I).
      action: Motor values of the selected action, shape (B, 2).
      value: Value of the selected action, shape (B,).
      chained: 1 for a robot whose next step continues this one, 0 for a robot that was placed
        elsewhere in between, shape (B,).
      best_action: Motor values of the best proposed action, shape (B, 2).
      best_value: Value of the best proposed action, shape (B,).
      reward: Reward of this step, shape (B,).
      rewarded: Whether `reward` is known, shape ().
    """

    NAMES: ClassVar = ("state", "action", "value", "chained")  # its tensors
    best_action: Tensor
    best_value: Tensor
    reward: Tensor
    rewarded: Tensor

    def __init__(self, robots: int, inputs: int) -> None:
        """Allocates a step of B robots with I network inputs."""
        self._rows = torch.arange(robots)
        self.state = torch.zeros(robots, inputs)
        self.action = torch.zeros(robots, 2)
        self.value = torch.zeros(robots)
        self.chained = torch.zeros(robots)

    def record(
        self, state: Tensor, actions: Tensor, values: Tensor, selected: Tensor, best: Tensor
    ) -> None:
        """Records a step.

        Args:
          state: Network inputs, shape (B, I).
          actions: Motor values of the evaluated actions, shape (B, A, 2).
          values: Values of the actions, shape (B, A).
          selected: Indices of the selected actions, shape (B,).
          best: Indices of the best proposed actions, shape (B,).
        """
        del best  # the paper's brain learns from the selected action only
        self.state.copy_(state)  # the caller may overwrite its own
        self.action.copy_(actions[self._rows, selected])
        self.value.copy_(values[self._rows, selected])
        self.chained.fill_(1)

    def forget(self, robots: Tensor | None = None) -> None:
        """Marks that the next step does not continue this one.

        Args:
          robots: Indices of the robots concerned; None for all.
        """
        self.chained[slice(None) if robots is None else robots] = 0

    def tensors(self) -> dict[str, Tensor]:
        """Returns copies of all tensors, for a checkpoint."""
        return {name: getattr(self, name).clone() for name in self.NAMES}

    def load(self, tensors: dict[str, Tensor]) -> None:
        """Restores a step from the tensors that `tensors` returned."""
        for name in self.NAMES:
            getattr(self, name).copy_(tensors[name])
