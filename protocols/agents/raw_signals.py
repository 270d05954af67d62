"""Agents that sense smell and reward before they saturate, as the brain `steady` does."""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np
import torch

from ...controller.senses import Encoding, Senses, Signal, unsaturated
from .base import Agent

_SHARE = Signal(0.0, 1.0)  # of the raw signal at maximal smell


def raw_senses(senses: Senses) -> Senses:
    """Returns what an agent senses in the track of raw signals.

    The raw value of each saturating signal, as a share of the largest, is a further signal; a
    saturating reward is replaced by its raw value.

    Args:
      senses: What the paper's robot senses.
    """
    further = tuple(_SHARE for signal in senses.state if signal.maximal)
    return Senses(senses.state + further, _SHARE if senses.reward.maximal else senses.reward)


class RawSignals(Agent):
    """An agent that is given raw signals and the raw reward."""

    def __init__(self, senses: Senses, make: Callable[[Senses], Agent]) -> None:
        """Makes the agent.

        Args:
          senses: What the paper's robot senses.
          make: Function that makes the agent for what it senses.
        """
        self._encoding = Encoding(senses.state, centred=False, raw_signals=True)
        maximal = senses.reward.maximal
        self._maximal = torch.tensor(maximal) if maximal else None
        self._agent = make(raw_senses(senses))

    def reset(self) -> None:
        """See `Agent.reset`."""
        self._agent.reset()

    def act(self, state: np.ndarray, learning: bool) -> np.ndarray:
        """See `Agent.act`."""
        return self._agent.act(self._encoding.state(torch.from_numpy(state)).numpy(), learning)

    def learn(self, reward: np.ndarray) -> None:
        """See `Agent.learn`."""
        if self._maximal is not None:
            reward = unsaturated(torch.from_numpy(reward), self._maximal).numpy()
        self._agent.learn(reward)

    def state(self) -> dict[str, np.ndarray]:
        """See `Agent.state`."""
        return self._agent.state()

    def load_state(self, arrays: Mapping[str, np.ndarray]) -> None:
        """See `Agent.load_state`."""
        self._agent.load_state(arrays)

    def weights(self) -> dict[str, np.ndarray]:
        """See `Agent.weights`."""
        return self._agent.weights()

    def load_weights(self, arrays: Mapping[str, np.ndarray]) -> None:
        """See `Agent.load_weights`."""
        self._agent.load_weights(arrays)
