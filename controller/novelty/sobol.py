"""Quasi-random actions: points of a Sobol sequence, shifted at random."""

from __future__ import annotations

import torch
from torch import Tensor
from torch.quasirandom import SobolEngine

from ..proposers import ActionProposer


class SobolActions(ActionProposer):
    """Proposes the first points of the Sobol sequence, shifted anew for each robot and step.

    An action is (x_k + u) mod 1 - 1/2, with the points x_k of the two-dimensional sequence (Sobol,
    1967) and one uniform shift u for a robot and a step (Cranley and Patterson, SIAM Journal on
    Numerical Analysis 13, 1976). Each action alone is uniform; together they leave smaller gaps
    than independent draws. All are distinct.

    The points are those of `torch.quasirandom`, so the controller needs no SciPy. The shift is
    drawn from the brain's own random stream, so that a checkpoint needs no state of the sequence; a
    scrambled sequence would keep one. The balance of the sequence is best for powers of 2, which 3,
    9 and 25 are not.
    """

    def __init__(self, count: int, generator: torch.Generator) -> None:
        """Takes the number of actions per robot, and the random stream of the shifts."""
        self._points = SobolEngine(2).draw(count).to(torch.get_default_device())
        self._generator = generator

    def propose(self, state: Tensor) -> Tensor:
        """See `ActionProposer.propose`."""
        size = len(state), 1, 2
        shift = torch.rand(size, generator=self._generator, device=state.device)
        return (self._points + shift) % 1 - 0.5
