"""Running mean and variance of a stream of values."""

from __future__ import annotations

import copy

import torch
from torch import Tensor

_EPSILON = 1e-8  # added to variances


class Moments:
    """Mean and variance of each robot's values so far, by Welford's method (1962).

    Attributes:
      count: Number of values of each robot so far, the prior included, shape (B, 1, ...).
      mean: Mean of the values, shape (B, ...); 0 before the first.
      squares: Sum of the values' squared deviations from the mean, shape (B, ...).
    """

    def __init__(self, *shape: int, prior: float = 0.0) -> None:
        """Begins as after `prior` values with mean 0 and variance 1; `shape` is (B, ...)."""
        one = shape[0], *[1] * (len(shape) - 1)
        self.count = torch.full(one, prior, dtype=torch.float64)
        self.mean = torch.zeros(*shape, dtype=torch.float64)
        self.squares = torch.full(shape, prior, dtype=torch.float64)

    def add(self, values: Tensor) -> None:
        """Adds a new value of each robot (and signal), shape (B, ...)."""
        self.count += 1
        apart = values - self.mean
        self.mean += apart / self.count
        self.squares += apart * (values - self.mean)

    def variance(self, unbiased: bool = True) -> Tensor:
        """Returns the variance, divided by n - 1 if `unbiased`, else by n; 1 for too few values."""
        divisor = self.count - int(unbiased)
        known = (self.count >= 1) & (divisor > 0)
        return torch.where(known, self.squares / torch.where(known, divisor, 1.0), 1.0)

    def deviation(self, unbiased: bool = True) -> Tensor:
        """Returns the standard deviation, never 0; see `variance`."""
        return (self.variance(unbiased) + _EPSILON).sqrt()

    def standardised(self, values: Tensor, keep: bool, unbiased: bool = True) -> Tensor:
        """Normalises values to mean 0 and variance 1, by moments that include these values.

        So no result exceeds the square root of the number of values, not even in a test in which a
        signal varies for the first time. If `keep`, as in training, the moments are updated. Tests
        before the first update return values unchanged.
        """
        if not (keep or (self.count >= 1).any()):
            return values
        moments = self if keep else copy.deepcopy(self)
        moments.add(values)
        return (values - moments.mean) / moments.deviation(unbiased)

    def tensors(self) -> list[Tensor]:
        """Returns the tensors that a checkpoint holds: count, mean, squares."""
        return [self.count, self.mean, self.squares]
