"""The state: what a robot senses, and how its networks receive it (section 3)."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import torch
from torch import Tensor


@dataclasses.dataclass(frozen=True)
class Signal:
    """The range of one sensor signal, or of the reward.

    Attributes:
      low: Smallest possible value.
      high: Largest possible value, above `low`.
      maximal: Raw signal x at maximal smell, if the signal saturates as s = x / (1 + x) (Eq. 3);
        None if the signal does not saturate.
    """

    low: float
    high: float
    maximal: float | None = None

    def __post_init__(self) -> None:
        """Raises ValueError unless low < high and, with `maximal`, low >= 0 and maximal > 0."""
        if not self.low < self.high:
            raise ValueError(f"low must be less than high, got {self.low} and {self.high}")
        if self.maximal is not None and not self.maximal > 0:
            raise ValueError(f"maximal must be positive, got {self.maximal}")
        if self.maximal is not None and self.low < 0:
            raise ValueError(f"a signal that saturates is not negative, got low {self.low}")


@dataclasses.dataclass(frozen=True)
class Senses:
    """The ranges of a robot's signals and reward, equal for all robots of a batch.

    Attributes:
      state: Ranges of the signals of a state, one for each of its S numbers.
      reward: Range of the reward.
    """

    state: tuple[Signal, ...]
    reward: Signal


class Encoding:
    """One input neuron for each sensor and motor, fed with the signal itself (section 3).

    Beyond the paper, inputs are scaled to [-1, 1], or raw signals are further inputs, or both.

    Attributes:
      inputs: Number I of network inputs for the state: S, plus one for each raw signal.
    """

    def __init__(
        self, signals: Sequence[Signal], centred: bool = False, raw_signals: bool = False
    ) -> None:
        """Prepares the encoding.

        Args:
          signals: Ranges of the S signals of a state.
          centred: Whether all inputs, motor values included, are scaled to [-1, 1].
          raw_signals: Whether the raw value of each saturating signal is a further input.
        """
        self._centred = centred
        saturating = {n: signal.maximal for n, signal in enumerate(signals) if signal.maximal}
        self._columns = torch.tensor([*saturating] if raw_signals else [], dtype=torch.int64)
        self._maximal = torch.tensor([*saturating.values()] if raw_signals else [])
        bounds = [(signal.low, signal.high) for signal in signals]
        bounds += [(0.0, 1.0)] * len(self._columns)
        self.inputs = len(bounds)
        low, high = torch.tensor(bounds).T
        self._middle, self._half = (high + low) / 2, (high - low) / 2

    def state(self, signals: Tensor) -> Tensor:
        """Returns network inputs, shape (B, I), for sensor signals, shape (B, S)."""
        if len(self._columns):
            raw = unsaturated(signals[:, self._columns], self._maximal)
            signals = torch.cat([signals, raw], dim=1)
        return (signals - self._middle) / self._half if self._centred else signals

    def motors(self, actions: Tensor) -> Tensor:
        """Returns inputs of the evaluation network for motor values, of the same shape."""
        return actions * 2 if self._centred else actions


def unsaturated(signal: Tensor, maximal: Tensor) -> Tensor:
    """Returns the raw signal x, where s = x / (1 + x), as a share of x at maximal smell.

    The result is clipped to [0, 1], for signals with noise.

    Args:
      signal: Saturating signal s, of any shape.
      maximal: Raw signal at maximal smell, broadcast against `signal`.
    """
    signal = torch.minimum(signal.clamp(min=0), maximal / (1 + maximal))
    return signal / (1 - signal) / maximal
