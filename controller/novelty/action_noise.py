"""Noise on the action of the memory instead of noise in its connections."""

from __future__ import annotations

import torch
from torch import Tensor

from ..creative_memory import CreativeMemory
from ..proposers import ActionProposer


class ActionNoise(ActionProposer):
    """Proposes the memory's main idea plus Gaussian noise on the motor values.

    The idea is a_k = clip(a + L z_k, -0.5, 0.5), with the main idea a, standard normal z_k and the
    Cholesky factor L of the covariance that noise in the connections would give in this state. The
    covariance is that of `SAMPLES` ideas of the memory, drawn anew in each step. They are not
    evaluated and are no candidates. So the number of candidates is that of noise in the
    connections, and a step costs `SAMPLES` ideas of the memory more. All candidates are distinct,
    but for those that are clipped to the same corner.

    Noise on the action is the usual exploration of continuous control (Lillicrap et al., ICLR
    2016); Plappert et al. (ICLR 2018) compare it with noise in the parameters.
    """

    SAMPLES = 25

    def __init__(self, memory: CreativeMemory, count: int, generator: torch.Generator) -> None:
        """Takes the memory, the number of ideas per robot, and the stream of the normal draws."""
        self._memory = memory
        self._count = count
        self._generator = generator

    def renew(self) -> None:
        """See `ActionProposer.renew`."""
        self._memory.renew()

    def propose(self, state: Tensor) -> Tensor:
        """See `ActionProposer.propose`."""
        samples = self._memory.ideas(state, self.SAMPLES)
        size = len(state), self._count, 2
        normals = torch.randn(size, generator=self._generator, device=state.device)
        main = self._memory.recall(state)[:, None]
        return (main + normals @ cholesky_factor(samples).mT).clamp(-0.5, 0.5)


def cholesky_factor(samples: Tensor) -> Tensor:
    """Returns the lower Cholesky factor of the samples' covariance, shape (B, 2, 2).

    A covariance of rank one or zero has a factor too, unlike in `torch.linalg.cholesky`.

    Args:
      samples: Actions, shape (B, n, 2), n at least 2.
    """
    around = samples - samples.mean(dim=1, keepdim=True)
    covariance = around.mT @ around / (samples.shape[1] - 1)
    first = covariance[:, 0, 0].sqrt()
    both = (covariance[:, 0, 1] / first).masked_fill_(~(first > 0), 0.0)
    second = (covariance[:, 1, 1] - both * both).clamp(min=0).sqrt()
    factor = torch.zeros_like(covariance)
    factor[:, 0, 0], factor[:, 1, 0], factor[:, 1, 1] = first, both, second
    return factor
