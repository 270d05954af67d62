"""Encoding of inputs and reward: centred inputs, raw signals, separate smell, raw reward."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor

from ..evaluation_network import Target
from ..senses import Senses
from ..step import Step


def unsaturated(signal: Tensor, maximal: Tensor) -> Tensor:
    """Returns the raw signal x, where s = x / (1 + x), as a share of x at maximal smell.

    The result is clipped to [0, 1], for signals with noise.

    Args:
      signal: Saturating signal s, of any shape.
      maximal: Raw signal at maximal smell, broadcast against `signal`.
    """
    signal = torch.minimum(signal.clamp(min=0), maximal / (1 + maximal))
    return signal / (1 - signal) / maximal


class InputEncoding:
    """Encoding that scales the inputs, adds raw signals as further inputs, or both.

    Attributes:
      inputs: Number I of network inputs for the state.
      smell: Indices of the inputs that are a saturating signal, or its raw value.
    """

    def __init__(self, senses: Senses, centred: bool, raw_signals: bool) -> None:
        """Prepares the encoding.

        Args:
          senses: Ranges of the S signals of a state.
          centred: Whether all inputs, motor values included, are scaled to [-1, 1].
          raw_signals: Whether the raw value of each saturating signal is a further input.
        """
        self._centred = centred
        columns = [number for number, signal in enumerate(senses.state) if signal.maximal]
        self._columns = torch.tensor(columns, dtype=torch.int64)
        self._maximal = torch.tensor([s.maximal for s in senses.state if s.maximal])
        self._raw = raw_signals and len(self._maximal) > 0
        further = len(self._maximal) * self._raw
        self.inputs = len(senses.state) + further
        self.smell = [*columns, *range(len(senses.state), self.inputs)]
        bounds = [(signal.low, signal.high) for signal in senses.state] + [(0.0, 1.0)] * further
        low, high = torch.tensor(bounds).T
        self._middle, self._half = (high + low) / 2, (high - low) / 2

    def state(self, signals: Tensor) -> Tensor:
        """See `Encoding.state`."""
        if self._raw:
            raw = unsaturated(signals[:, self._columns], self._maximal)
            signals = torch.cat([signals, raw], dim=1)
        return (signals - self._middle) / self._half if self._centred else signals

    def motors(self, actions: Tensor) -> Tensor:
        """See `Encoding.motors`."""
        return actions * 2 if self._centred else actions


def separated(hidden: int, state: int, smell: Sequence[int], inputs: int) -> Tensor | None:
    """Returns which hidden neurons receive which inputs: 1 or 0, shape (H, I).

    Args:
      hidden: Number H of hidden neurons; the first half of them receives the smell.
      state: Number of inputs for the state, which come first; all neurons receive the others.
      smell: Indices of the inputs that are the smell.
      inputs: Number I of inputs.

    Returns:
      The connections; None where the smell is no input, or the only one.
    """
    others = [number for number in range(state) if number not in smell]
    if not smell or not others:
        return None
    connected = torch.ones(hidden, inputs)
    connected[: hidden // 2, others] = 0
    connected[hidden // 2 :, list(smell)] = 0
    return connected


class RawReward:
    """A target computed from the raw reward, 1 at maximal smell."""

    def __init__(self, target: Target, maximal: float) -> None:
        """Takes the target, and the raw reward at maximal smell."""
        self._target = target
        self._maximal = torch.tensor(maximal)

    def __call__(self, reward: Tensor, before: Step, now: Step) -> tuple[Tensor, Tensor]:
        """See `Target.__call__`."""
        return self._target(unsaturated(reward, self._maximal), before, now)
