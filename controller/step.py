"""One control step as the brain remembers it until it has learned from it (section 2)."""

from __future__ import annotations

from functools import cached_property

import torch
from torch import Tensor


class Step:
    """What B robots sensed, selected and considered best in one control step.

    Attributes:
      state: Network inputs, shape (B, I).
      action: Motor values of the selected action, shape (B, 2).
      value: Value of the selected action, shape (B,).
      chained: 1 for a robot whose next step continues this one, 0 for a robot that was placed
        elsewhere in between, shape (B,).
      reward: Reward of this step, shape (B,); set by targets that compare successive rewards.
      rewarded: Whether `reward` is known.
    """

    reward: Tensor

    def __init__(
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
        self._rows = torch.arange(len(state))
        self._actions, self._values, self._best = actions, values, best
        self.state = state.clone()  # the caller may overwrite its own
        self.action = actions[self._rows, selected]
        self.value = values[self._rows, selected]
        self.chained = torch.ones(len(state))
        self.rewarded = False

    @classmethod
    def blank(cls, robots: int, inputs: int) -> Step:
        """Returns a step before the first one, to which no other is chained."""
        first = torch.zeros(robots, dtype=torch.int64)
        step = cls(
            torch.zeros(robots, inputs),
            torch.zeros(robots, 1, 2),
            torch.zeros(robots, 1),
            selected=first,
            best=first,
        )
        step.forget()
        return step

    @cached_property
    def best_action(self) -> Tensor:
        """Motor values of the best proposed action, shape (B, 2)."""
        return self._actions[self._rows, self._best]

    @cached_property
    def best_value(self) -> Tensor:
        """Value of the best proposed action, shape (B,)."""
        return self._values[self._rows, self._best]

    def forget(self, robots: Tensor | None = None) -> None:
        """Breaks the chain to the next step.

        Args:
          robots: Indices of the robots concerned; None for all.
        """
        # A copy, because inference mode forbids changing its tensors elsewhere.
        self.chained = self.chained.clone()
        self.chained[slice(None) if robots is None else robots] = 0

    def tensors(self) -> dict[str, Tensor]:
        """Returns copies of all tensors, for a checkpoint."""
        return {
            "state": self.state.clone(),
            "action": self.action.clone(),
            "value": self.value.clone(),
            "best_action": self.best_action.clone(),
            "best_value": self.best_value.clone(),
            "chained": self.chained.clone(),
            "reward": self.reward.clone() if self.rewarded else torch.zeros_like(self.value),
            "rewarded": torch.tensor(self.rewarded),
        }

    @classmethod
    def from_tensors(cls, tensors: dict[str, Tensor]) -> Step:
        """Returns the step of a checkpoint, from what `tensors` returned."""
        selected = torch.zeros(len(tensors["state"]), dtype=torch.int64)
        step = cls(
            tensors["state"],
            torch.stack([tensors["action"], tensors["best_action"]], dim=1),
            torch.stack([tensors["value"], tensors["best_value"]], dim=1),
            selected=selected,
            best=selected + 1,
        )
        step.chained = tensors["chained"].clone()
        step.reward = tensors["reward"].clone()
        step.rewarded = bool(tensors["rewarded"])
        return step
