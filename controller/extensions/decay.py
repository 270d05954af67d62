"""Epsilon and the learn rate, constant or decaying over training."""

from __future__ import annotations

import math

import torch
from torch import Tensor


class Schedule:
    """A parameter as a function of the number of training steps; this one is constant.

    Attributes:
      value: Value in the present step, a number; on another device than the host, a value that
        changes is a tensor of shape () that keeps its place, so that a captured step finds it.
    """

    value: float | Tensor

    def __init__(self, value: float | Tensor) -> None:
        """Takes the value."""
        self.value = value

    def update(self, age: Tensor) -> None:
        """Sets the value after `age` steps of training."""


class Decay(Schedule):
    """An exponential decay from an initial to a final value."""

    def __init__(self, initial: float, final: float, steps: float) -> None:
        """Takes the two values, and the time constant in steps of training."""
        self._initial = initial
        self._final = final
        self._steps = steps
        on_host = torch.get_default_device().type == "cpu"
        super().__init__(initial if on_host else torch.full((), float(initial)))

    def update(self, age: Tensor) -> None:
        """See `Schedule.update`."""
        value = self._final + (self._initial - self._final) * math.exp(-int(age) / self._steps)
        self.value = self.value.fill_(value) if isinstance(self.value, Tensor) else value
