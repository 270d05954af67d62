"""Random actions among the ideas of the creative memory."""

from __future__ import annotations

import torch
from torch import Tensor

from ..proposers import ActionProposer


class WithRandomIdeas:
    """Proposes the ideas of the memory, followed by random actions."""

    def __init__(self, memory: ActionProposer, random: ActionProposer) -> None:
        """Takes the proposers of the memory's ideas and of the random actions."""
        self._memory = memory
        self._random = random

    def propose(self, state: Tensor) -> Tensor:
        """See `ActionProposer.propose`."""
        return torch.cat([self._memory.propose(state), self._random.propose(state)], dim=1)
