"""How a brain reads its senses: the signals as they are, as in the paper, or stretched."""

from __future__ import annotations

import dataclasses
import math

import torch
from torch import Tensor

from .parameters import Parameters


@dataclasses.dataclass(frozen=True)
class Signal:
    """What a brain is told of a number that it senses, or is rewarded with.

    Attributes:
      low: the smallest it can be.
      high: the largest.
      full: where it saturates, as s = x / (1 + x) of a raw signal x >= 0: x at a full load;
        None where it does not.
    """

    low: float
    high: float
    full: float | None = None

    def __post_init__(self) -> None:
        """Raises ValueError where there is nothing between low and high, or no full load."""
        if not self.low < self.high:
            raise ValueError(f"low must be less than high, got {self.low} and {self.high}")
        if self.full is not None and not self.full > 0:
            raise ValueError(f"full must be positive, got {self.full}")

    @property
    def saturated(self) -> float:
        """The signal of a full load; infinity where there is none."""
        return self.full / (1 + self.full) if self.full else math.inf


@dataclasses.dataclass(frozen=True)
class Senses:
    """A robot's senses, the same for every robot of a batch.

    Attributes:
      state: one entry for each number in a state.
      reward: the reward's.
    """

    state: tuple[Signal, ...]
    reward: Signal


class Reading:
    """From signals to what the networks are given.

    Attributes:
      inputs: I, how many numbers the networks are given of a state.
    """

    def __init__(self, parameters: Parameters, sensors: int, senses: Senses | None) -> None:
        """Prepares to read states of S sensors.

        Args:
          parameters: how to read.
          sensors: S.
          senses: what the S numbers and the reward are; None is enough to read them as they are.

        Raises:
          ValueError: the senses are not told, or not of S numbers.
        """
        self._centred = parameters.centred
        self._raw = False
        self._reward_full: Tensor | None = None
        self.inputs = sensors
        if not (self._centred or parameters.knows_full_load):
            return
        if senses is None or len(senses.state) != sensors:
            raise ValueError(f"a brain that knows of signals must be told of all {sensors}")
        self._full_signal = torch.tensor(senses.reward.saturated)
        if parameters.raw_reward and senses.reward.full:
            self._reward_full = torch.tensor(senses.reward.full)
        self._columns = torch.tensor([bool(s.full) for s in senses.state]).nonzero()[:, 0]
        self._full = torch.tensor([signal.full for signal in senses.state if signal.full])
        self._raw = parameters.raw_signals and len(self._full) > 0
        further = len(self._full) * self._raw
        self.inputs += further
        bounds = [(signal.low, signal.high) for signal in senses.state] + [(0.0, 1.0)] * further
        low, high = torch.tensor(bounds).T
        self._middle, self._half = (high + low) / 2, (high - low) / 2

    def state(self, signals: Tensor) -> Tensor:
        """The networks' inputs, shape (B, I), from signals, shape (B, S)."""
        if self._raw:
            raw = unsaturated(signals[:, self._columns], self._full)
            signals = torch.cat([signals, raw], dim=1)
        return (signals - self._middle) / self._half if self._centred else signals

    def motors(self, actions: Tensor) -> Tensor:
        """Motor values as the evaluation network is given them, of the same shape."""
        return actions * 2 if self._centred else actions

    def reward(self, signal: Tensor) -> Tensor:
        """The reward, from its signal, shapes (B,)."""
        full = self._reward_full
        return signal if full is None else unsaturated(signal, full)

    def is_full(self, signal: Tensor) -> Tensor:
        """Whether the reward's signal is that of a full load, if there is one; shapes (B,)."""
        return signal >= self._full_signal


def unsaturated(signal: Tensor, full: Tensor) -> Tensor:
    """The x of s = x / (1 + x), as a share of a full load.

    No noise on a signal makes more of it than a full load, nor less than none.
    """
    signal = torch.minimum(signal.clamp(min=0), full / (1 + full))
    return signal / (1 - signal) / full
