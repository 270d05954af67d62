"""A control step with the best action and the reward, for parts that learn from them."""

from __future__ import annotations

import torch
from torch import Tensor

from ..step import Step


class DetailedStep(Step):
    """What B robots sensed and selected, the best proposed action, and the reward if known."""

    def __init__(self, robots: int, inputs: int) -> None:
        """Allocates a step of B robots with I network inputs."""
        super().__init__(robots, inputs)
        self.best_action = torch.zeros(robots, 2)
        self.best_value = torch.zeros(robots)
        self.reward = torch.zeros(robots)
        self.rewarded = torch.tensor(False)

    def record(
        self, state: Tensor, actions: Tensor, values: Tensor, selected: Tensor, best: Tensor
    ) -> None:
        """See `Step.record`; the reward is not known yet."""
        super().record(state, actions, values, selected, best)
        self.best_action.copy_(actions[self._rows, best])
        self.best_value.copy_(values[self._rows, best])
        self.rewarded.zero_()

    def tensors(self) -> dict[str, Tensor]:
        """See `Step.tensors`."""
        return super().tensors() | {
            "best_action": self.best_action.clone(),
            "best_value": self.best_value.clone(),
            # An unknown reward is 0, so that equal steps have equal checkpoints.
            "reward": self.reward.masked_fill(~self.rewarded, 0.0),
            "rewarded": self.rewarded.clone(),
        }

    def load(self, tensors: dict[str, Tensor]) -> None:
        """See `Step.load`."""
        super().load(tensors)
        for name in ("best_action", "best_value", "reward", "rewarded"):
            getattr(self, name).copy_(tensors[name])
