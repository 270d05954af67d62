"""What a robot senses, and how the networks receive it (section 3)."""

from __future__ import annotations

import dataclasses
import math
from typing import Protocol

from torch import Tensor


@dataclasses.dataclass(frozen=True)
class Signal:
    """The range of one sensor signal, or of the reward.

    Attributes:
      low: Smallest value.
      high: Largest value.
      maximal: Raw signal x at maximal smell, if the signal saturates as s = x / (1 + x) (Eq. 3);
        None if the signal does not saturate.
    """

    low: float
    high: float
    maximal: float | None = None

    def __post_init__(self) -> None:
        """Raises ValueError for an empty range, or one that cannot saturate."""
        if not self.low < self.high:
            raise ValueError(f"low must be less than high, got {self.low} and {self.high}")
        if self.maximal is not None and not self.maximal > 0:
            raise ValueError(f"maximal must be positive, got {self.maximal}")
        if self.maximal is not None and self.low < 0:
            raise ValueError(f"a signal that saturates is not negative, got low {self.low}")

    @property
    def saturated(self) -> float:
        """The signal at maximal smell; infinity where the signal does not saturate."""
        return self.maximal / (1 + self.maximal) if self.maximal else math.inf


@dataclasses.dataclass(frozen=True)
class Senses:
    """The ranges of a robot's signals and reward, equal for all robots of a batch.

    Attributes:
      state: Ranges of the signals of a state, one for each of its S numbers.
      reward: Range of the reward.
    """

    state: tuple[Signal, ...]
    reward: Signal


class Encoding(Protocol):
    """Turns signals and motor values into network inputs.

    Attributes:
      inputs: Number I of network inputs for the state.
    """

    inputs: int

    def state(self, signals: Tensor) -> Tensor:
        """Returns network inputs, shape (B, I), for sensor signals, shape (B, S)."""
        ...

    def motors(self, actions: Tensor) -> Tensor:
        """Returns inputs of the evaluation network for motor values, of the same shape."""
        ...


class DirectEncoding:
    """One input neuron for each sensor and motor, fed with the signal itself (section 3).

    Attributes:
      inputs: Number of network inputs for the state, equal to the number of sensors.
    """

    def __init__(self, sensors: int) -> None:
        """Encodes states with this number of sensor signals."""
        self.inputs = sensors

    def state(self, signals: Tensor) -> Tensor:
        """Returns the signals."""
        return signals

    def motors(self, actions: Tensor) -> Tensor:
        """Returns the motor values."""
        return actions
