"""A control step with the best action and the reward, for parts that learn from them."""

from __future__ import annotations

import torch
from torch import Tensor

from ..step import Step


class DetailedStep(Step):
    """What B robots sensed and selected, the best proposed action, and the reward if known."""

    NAMES = (*Step.NAMES, "best_action", "best_value", "reward", "rewarded")

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
        # An unknown reward is 0, so that equal steps have equal checkpoints.
        return super().tensors() | {"reward": self.reward.masked_fill(~self.rewarded, 0.0)}
