"""A limit on the TD error, which makes it the gradient of the Huber loss."""

from __future__ import annotations

from torch import Tensor

from ..evaluation_network import td_error


class LimitedTDError:
    """The TD error, clipped to [-limit, limit]."""

    def __init__(self, limit: float) -> None:
        """Takes the largest magnitude of the error."""
        self._limit = limit

    def __call__(self, target: Tensor, value: Tensor, learning: Tensor) -> Tensor:
        """See `evaluation_network.td_error`."""
        return td_error(target, value, learning).clamp(-self._limit, self._limit)
