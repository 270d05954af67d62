"""Other rewards in the target: reward difference, reward decay and advantage learning."""

from __future__ import annotations

import torch
from torch import Tensor

from ..evaluation_network import Target
from ..step import Step


class AdvantageLearning:
    """A lower reward for a worse action, r <- r - alpha (V_best - V_selected) at time t.

    An exploratory action whose value exceeds that of every idea is not rewarded more.
    """

    def __init__(self, target: Target, scale: float) -> None:
        """Takes the target, and the factor alpha."""
        self._target = target
        self._scale = scale

    def __call__(self, reward: Tensor, before: Step, now: Step) -> tuple[Tensor, Tensor]:
        """See `Target.__call__`."""
        worse = (before.best_value - before.value).clamp(min=0)
        return self._target(reward - self._scale * worse, before, now)


class RewardDifference:
    """A target whose reward is the difference of successive rewards, r(t + 1) - r(t).

    It needs the rewards that `RememberedReward` keeps.
    """

    def __init__(self, target: Target) -> None:
        """Takes the target that receives the difference as its reward."""
        self._target = target

    def __call__(self, reward: Tensor, before: Step, now: Step) -> tuple[Tensor, Tensor]:
        """See `Target.__call__`."""
        return self._target(reward - before.reward, before, now)


class RememberedReward:
    """Keeps the reward of each step, for targets that compare successive rewards.

    Robots do not learn from a step for which the previous reward is unknown.
    """

    def __init__(self, target: Target, decay: float) -> None:
        """Takes the parts of the target.

        Args:
          target: Target that is computed from the rewards kept in the steps.
          decay: Lower bound of the next step's reward, as a share in [0, 1) of this step's reward;
            negative rewards are kept.
        """
        self._target = target
        self._decay = decay

    def __call__(self, reward: Tensor, before: Step, now: Step) -> tuple[Tensor, Tensor]:
        """See `Target.__call__`."""
        before.reward.masked_fill_(~before.rewarded, 0.0)
        if self._decay:
            left = self._decay * before.reward * before.chained
            reward = torch.where(reward < 0, reward, torch.maximum(reward, left))
        now.reward.copy_(reward)  # the caller may overwrite its own
        now.rewarded.fill_(True)
        target, learning = self._target(reward, before, now)
        return target, learning * before.rewarded
