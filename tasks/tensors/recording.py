"""Work of a GPU that is recorded once and replayed: the host launches all its kernels by one call.

A control step consists of hundreds of small kernels, and a host needs longer to launch them one by
one than the GPU needs to run them.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import torch

Work = Callable[[], Any]


def records(device: torch.device) -> bool:
    """Returns whether work on a device can be recorded."""
    return device.type == "cuda"


def record(work: Work, generator: torch.Generator | None = None) -> tuple[Work, Any]:
    """Records work without doing it.

    Args:
      work: Work to record. It has been done before, so that libraries have started; it reads and
        overwrites tensors that keep their places, and no number of them on the host.
      generator: Random stream that the work uses; a replay continues it.

    Returns:
      Function that does the work, and what the work returned: tensors that it overwrites.
    """
    graph = torch.cuda.CUDAGraph()
    if generator is not None:
        graph.register_generator_state(generator)
    with torch.cuda.graph(graph):
        result = work()
    return graph.replay, result


class Recorded:
    """Work that returns nothing, done directly twice, and replayed from then on."""

    def __init__(self, work: Work, device: torch.device) -> None:
        """Takes the work and its device; where that cannot record, the work is always done."""
        self._work = work
        self._direct = 2 if records(device) else -1  # calls that are left

    def __call__(self) -> None:
        """Does the work."""
        if self._direct == 0:
            self._work, _ = record(self._work)
        self._direct -= self._direct >= 0
        self._work()
