"""A control step, which the brain remembers until it has learned from the step (section 2)."""

from __future__ import annotations

import torch
from torch import Tensor


class Step:
    """What B robots sensed and selected in one control step.

    One object records many steps; each overwrites the one before. Before the first, `chained` is 0.
    Only a detailed step has the attributes from `best_action` on; the paper's brain needs none.

    Attributes:
      state: Network inputs, shape (B, I).
      action: Motor values of the selected action, shape (B, 2).
      value: Value of the selected action, shape (B,).
      chained: 1 for a robot whose next step continues this one, 0 for a robot that was placed
        elsewhere in between, shape (B,).
      best_action: Motor values of the best proposed action, shape (B, 2).
      best_value: Value of the best proposed action, shape (B,).
      reward: Reward of this step; 0 until it is known, shape (B,).
      rewarded: Whether `reward` is known, shape ().
    """

    def __init__(self, robots: int, inputs: int, detailed: bool) -> None:
        """Allocates a step of B robots with I network inputs."""
        self._rows = torch.arange(robots)
        self._detailed = detailed
        self.state = torch.zeros(robots, inputs)
        self.action = torch.zeros(robots, 2)
        self.value = torch.zeros(robots)
        self.chained = torch.zeros(robots)
        if detailed:
            self.best_action = torch.zeros(robots, 2)
            self.best_value = torch.zeros(robots)
            self.reward = torch.zeros(robots)
            self.rewarded = torch.tensor(False)

    def record(
        self, state: Tensor, actions: Tensor, values: Tensor, selected: Tensor, best: Tensor
    ) -> None:
        """Records a step, whose reward is not known yet.

        Args:
          state: Network inputs, shape (B, I).
          actions: Motor values of the evaluated actions, shape (B, A, 2).
          values: Values of the actions, shape (B, A).
          selected: Indices of the selected actions, shape (B,).
          best: Indices of the best proposed actions, shape (B,).
        """
        self.state.copy_(state)  # the caller may overwrite its tensor
        self.action.copy_(actions[self._rows, selected])
        self.value.copy_(values[self._rows, selected])
        self.chained.fill_(1)
        if self._detailed:
            self.best_action.copy_(actions[self._rows, best])
            self.best_value.copy_(values[self._rows, best])
            self.reward.zero_()
            self.rewarded.zero_()

    def record_reward(self, reward: Tensor) -> None:
        """Records the reward of a detailed step, shape (B,)."""
        self.reward.copy_(reward)
        self.rewarded.fill_(True)

    def forget(self, robots: Tensor | None = None) -> None:
        """Marks that the next step does not continue this one.

        Args:
          robots: Indices of the robots that are placed elsewhere, shape (n,); None for all.
        """
        self.chained[slice(None) if robots is None else robots] = 0

    def tensors(self) -> dict[str, Tensor]:
        """Returns the tensors themselves, not copies, by name, for a checkpoint."""
        names = ["state", "action", "value", "chained"]
        if self._detailed:
            names += ["best_action", "best_value", "reward", "rewarded"]
        return {name: getattr(self, name) for name in names}
