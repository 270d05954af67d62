"""What agents sense: the signals of a task, as they are or before they saturate."""

from __future__ import annotations

import numpy as np
import torch

from ...controller.senses import Encoding, Senses, Signal, unsaturated
from ...tasks.suite import task_definition
from .base import Agent, Wrapper

_SHARE = Signal(0.0, 1.0)  # raw signal over that at maximal smell


def senses_of(task: str) -> Senses:
    """Returns the ranges of the signals that the robots of a task observe.

    Raises:
      ValueError: there is no such task.
    """
    rules = task_definition(task).rules
    signals = [
        Signal(low, high, rules.maximal.get(name))
        for name, (length, low, high) in rules.shapes.items()
        for _ in range(length)
    ]
    return Senses(tuple(signals), Signal(*rules.rewards, rules.maximal.get("reward")))


def raw_senses(senses: Senses) -> Senses:
    """Returns what an agent senses with the observation set "raw".

    Each saturating signal adds a signal: its unsaturated value as a share of the largest. Such a
    share also replaces a saturating reward.
    """
    further = tuple(_SHARE for signal in senses.state if signal.maximal)
    return Senses(senses.state + further, _SHARE if senses.reward.maximal else senses.reward)


class RawSignals(Wrapper):
    """A wrapper that gives its agent unsaturated smell and reward, as the brain `steady` has."""

    def __init__(self, senses: Senses, agent: Agent) -> None:
        """Wraps an agent made for `raw_senses(senses)`; `senses` are the task's (`senses_of`)."""
        super().__init__(agent)
        self._encoding = Encoding(senses.state, centred=False, raw_signals=True)
        maximal = senses.reward.maximal
        self._maximal = torch.tensor(maximal) if maximal else None

    def act(self, state: np.ndarray, learning: bool) -> np.ndarray:
        return self.agent.act(self._encoding.state(torch.from_numpy(state)).numpy(), learning)

    def learn(self, reward: np.ndarray) -> None:
        if self._maximal is not None:
            reward = unsaturated(torch.from_numpy(reward), self._maximal).numpy()
        self.agent.learn(reward)
