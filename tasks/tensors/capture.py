"""Work of a GPU that is captured once and replayed: the host launches all its kernels by one call.

A control step consists of hundreds of small kernels, and a host needs longer to launch them one by
one than the GPU needs to run them.
"""

from __future__ import annotations

from collections.abc import Callable

import torch

Work = Callable[[], None]

_DIRECT = 2  # first calls, not captured: libraries start, and the brain remembers two steps


def captures(device: torch.device) -> bool:
    """Returns whether work on a device can be captured."""
    return device.type == "cuda"


def capture(work: Work, device: torch.device, generator: torch.Generator | None = None) -> Work:
    """Captures work as a CUDA graph, without doing it, and returns a function that does it.

    Args:
      work: Function to capture. It must have been called before, so that libraries have started.
        It changes tensors in place, and reads none of their numbers on the host.
      device: CUDA device of the tensors.
      generator: Random stream of `work`. Each call of the returned function draws new numbers.
    """
    with torch.cuda.device(device):
        graph = torch.cuda.CUDAGraph()
        if generator is not None:
            graph.register_generator_state(generator)
        with torch.cuda.graph(graph, stream=torch.cuda.Stream(device)):
            work()
    return graph.replay


class Captured:
    """Work that runs directly in two calls; later calls replay it on a device that can capture."""

    def __init__(
        self, work: Work, device: torch.device, generator: torch.Generator | None = None
    ) -> None:
        """Takes the arguments of `capture`."""
        self._work = work
        self._device = device
        self._generator = generator
        self._pending = captures(device)
        self._calls = 0

    def __call__(self) -> None:
        """Does the work."""
        if self._pending and self._calls == _DIRECT:
            self._work = capture(self._work, self._device, self._generator)
            self._pending = False
        self._calls += 1
        self._work()
