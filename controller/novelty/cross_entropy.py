"""The cross-entropy method: a second round of actions around the best of a first one."""

from __future__ import annotations

import math
from collections.abc import Callable

import torch
from torch import Tensor

from ..proposers import ActionProposer


class CrossEntropy(ActionProposer):
    """Proposes actions in two rounds of the cross-entropy method.

    The first half, rounded up, is uniform. Its best quarter, at least one action, is the elite. The
    second half is normal around the elite's mean mu, separately in both motors and clipped, with
    sigma = `SMOOTHING` * s + (1 - `SMOOTHING`) * sigma_0: s is the elite's standard deviation (of
    the population), sigma_0 that of uniform actions. Without the smoothing an elite of one action
    would have no spread.

    Both rounds are candidates, so the number of candidates and of evaluated actions is that of
    other proposers; the values of the first half are computed a second time when the best is
    selected. All candidates are distinct, but for those that are clipped to the same corner.

    Sources: de Boer, Kroese, Mannor and Rubinstein, Annals of Operations Research 134 (2005), with
    smoothed updates; two rounds per decision as in QT-Opt (Kalashnikov et al., CoRL 2018). The
    quarter and the weight of the smoothing are ours.
    """

    ELITE = 0.25
    SMOOTHING = 0.7
    SPREAD = 1 / math.sqrt(12)  # standard deviation of a uniform motor value

    def __init__(
        self,
        values: Callable[[Tensor, Tensor], Tensor],
        count: int,
        generator: torch.Generator,
    ) -> None:
        """Takes the parts of the proposer.

        Args:
          values: Function of network inputs, shape (B, I), and motor values, shape (B, A, 2), that
            returns the values of the actions, shape (B, A).
          count: Number of actions per robot.
          generator: Random stream of the draws.
        """
        self._values = values
        self._first, self._second = -(-count // 2), count // 2
        self._generator = generator

    def propose(self, state: Tensor) -> Tensor:
        """See `ActionProposer.propose`."""
        robots = len(state)
        generator, device = self._generator, state.device
        first = torch.rand(robots, self._first, 2, generator=generator, device=device) - 0.5
        normals = torch.randn(robots, self._second, 2, generator=generator, device=device)
        return torch.cat([first, self.around(first, self._values(state, first), normals)], dim=1)

    def around(self, actions: Tensor, values: Tensor, normals: Tensor) -> Tensor:
        """Returns the second round of actions, shape (B, N, 2).

        Args:
          actions: Motor values of the first round, shape (B, A, 2).
          values: Their values, shape (B, A).
          normals: Standard normal numbers, shape (B, N, 2).
        """
        count = max(1, round(self.ELITE * actions.shape[1]))
        best = values.topk(count, dim=1).indices
        elite = actions.gather(1, best[..., None].expand(-1, -1, 2))
        mean, spread = elite.mean(1, keepdim=True), elite.std(1, correction=0, keepdim=True)
        spread = self.SMOOTHING * spread + (1 - self.SMOOTHING) * self.SPREAD
        return (mean + spread * normals).clamp(-0.5, 0.5)
