"""The memory's main idea among the proposed actions."""

from __future__ import annotations

from torch import Tensor

from ..creative_memory import Memory
from ..proposers import ActionProposer


class MainIdeaCopies(ActionProposer):
    """Proposes the memory's main idea, the action without noise, in every place.

    The copies are evaluated as other ideas are, so the cost is equal. They are one candidate for
    the maximum: the max target bootstraps from the value of the main idea, as in an actor-critic
    method, unless random actions follow.
    """

    def __init__(self, memory: Memory, count: int) -> None:
        """Takes the memory, and the number of copies per robot."""
        self._memory = memory
        self._count = count

    def propose(self, state: Tensor) -> Tensor:
        """See `ActionProposer.propose`."""
        return self._memory.recall(state)[:, None].repeat(1, self._count, 1)
