"""Actions of two proposers, such as ideas of the memory and random actions."""

from __future__ import annotations

import torch
from torch import Tensor

from ..proposers import ActionProposer


class Joined(ActionProposer):
    """Proposes the actions of one proposer, followed by those of another."""

    def __init__(self, first: ActionProposer, second: ActionProposer) -> None:
        """Takes both proposers."""
        self._first = first
        self._second = second

    def renew(self) -> None:
        """See `ActionProposer.renew`."""
        self._first.renew()
        self._second.renew()

    def propose(self, state: Tensor) -> Tensor:
        """See `ActionProposer.propose`."""
        return torch.cat([self._first.propose(state), self._second.propose(state)], dim=1)
