"""Decay of epsilon and of the learn rate over training."""

from __future__ import annotations

import math

from torch import Tensor


class Decay:
    """An exponential decay from an initial to a final value."""

    def __init__(self, initial: float, final: float, steps: float) -> None:
        """Takes the two values, and the time constant in steps of training."""
        self._initial = initial
        self._final = final
        self._steps = steps

    def __call__(self, age: Tensor) -> float:
        """Returns the value after `age` steps of training."""
        return self._final + (self._initial - self._final) * math.exp(-int(age) / self._steps)
