"""Noise in the connections of the creative memory, which makes new ideas (section 3)."""

from __future__ import annotations

import torch
from torch import Tensor


class NoisePatterns:
    """Noise patterns, one for each idea: which connections are noisy, and the sign of the noise.

    A pattern has exactly n = round(share * N) of N connections at +noise or -noise (1 where a
    share above 0 would round to 0), and the others at 0; positions and signs are uniform. A pool of
    `POOL` patterns is drawn at once, every idea takes one of them at random, and the pool is
    redrawn every `LIFETIME` steps. Each idea has the distribution of an individual draw; for 50
    robots or more it takes a tenth of the time. Two ideas share a pattern of the pool with a
    probability of 1 in `POOL`, so they are equal more often than individual draws would be.
    """

    POOL = 16384
    LIFETIME = 500

    def __init__(
        self, connections: int, share: float, noise: float, generator: torch.Generator
    ) -> None:
        """Prepares patterns; the first `renew` fills the pool.

        Args:
          connections: Number N of connections.
          share: Share of noisy connections, in [0, 1].
          noise: Magnitude of the noise, which is added to or subtracted from a noisy connection.
          generator: Random stream from which patterns are drawn.
        """
        self.connections = connections
        self.noisy = max(round(share * connections), 1 if share > 0 else 0)
        self.noise = noise
        self._generator = generator
        self._pool = torch.zeros(self.POOL, connections)
        self._age = torch.tensor([self.LIFETIME], device="cpu")  # read in every step

    def renew(self) -> None:
        """Redraws the pool if it is old; to be called before each step that draws."""
        if self._age >= self.LIFETIME:
            self._refill()
        self._age += 1

    def draw(self, count: int) -> Tensor:
        """Draws patterns, shape (count, N)."""
        generator, device = self._generator, self._pool.device
        rows = torch.randint(self.POOL, (count,), generator=generator, device=device)
        return self._pool.index_select(0, rows)

    def _refill(self) -> None:
        generator, device = self._generator, self._pool.device
        keys = torch.rand(self._pool.shape, generator=generator, device=device)
        chosen = keys.argsort(dim=1)[:, : self.noisy]
        signs = torch.randint(2, chosen.shape, generator=generator, device=device) * 2.0 - 1.0
        self._pool.zero_().scatter_(1, chosen, self.noise * signs)
        self._age.zero_()

    def tensors(self) -> dict[str, Tensor]:
        """Returns the pool and its age in steps, for a checkpoint."""
        return {"pool": self._pool, "age": self._age}


class HeldNoisePatterns:
    """Noise patterns that ideas keep for several steps, or for life.

    The paper says how much noise an idea has, not when it is drawn anew.
    """

    def __init__(self, patterns: NoisePatterns, count: int, steps: int) -> None:
        """Prepares patterns to hold; the first `renew` draws them.

        Args:
          patterns: Patterns that are drawn, each of them to be held.
          count: Number of patterns in a step.
          steps: Number of steps for which they are held; 0 for life.
        """
        self.noisy = patterns.noisy
        self._patterns = patterns
        self._steps = steps
        self._held = torch.zeros(count, patterns.connections)
        # Steps before the next draw, -1 for life; read in every step.
        self._left = torch.tensor([0], device="cpu")

    def renew(self) -> None:
        """Draws other patterns if it is time; to be called before each step that draws."""
        if self._left == 0:
            self._patterns.renew()
            self._held.copy_(self._patterns.draw(len(self._held)))
            self._left.fill_(self._steps or -1)
        if self._steps:
            self._left -= 1

    def draw(self, count: int) -> Tensor:
        """Returns the held patterns, shape (count, N).

        Raises:
          ValueError: Another number of patterns is held.
        """
        if count != len(self._held):
            raise ValueError(f"{len(self._held)} patterns are held, not {count}")
        return self._held.clone()

    def tensors(self) -> dict[str, Tensor]:
        """Returns the held patterns and those from which they are drawn, for a checkpoint."""
        return self._patterns.tensors() | {"held": self._held, "left": self._left}
