"""SARSA(lambda) with tile coding."""

from __future__ import annotations

import torch
from torch import Tensor

from ....controller.senses import Senses
from ...errors import InputError
from ..settings import Number, Setting, tunable
from .base import ACTIONS, OnlineLearner, epsilon, epsilon_steps
from .networks import column

_PRIMES = 73_856_093, 19_349_663, 83_492_791, 49_979_687, 67_867_967, 86_028_121, 32_452_843
_MIXER = 0x85EBCA6B


class SarsaLambda(OnlineLearner):
    """SARSA(lambda) with replacing traces and tile coding, for the 25 fixed actions.

    Sutton and Barto, "Reinforcement Learning: An Introduction", 2nd edition, 2018: section 9.5.4
    (tile coding, tilings displaced by odd numbers) and 12.7 (SARSA(lambda), with traces set to 1).
    Q(s, a) is the sum of one weight per tiling. In training, ties of values are broken at random;
    in tests, by a random order of actions, fixed for each robot. Traces are kept for `MEMORY`
    steps; those of older steps are below 0.004 with the largest settings, below 2e-7 with the
    defaults. Each tile has its own weight if a tiling has at most `cells` tiles; otherwise a hash
    of the tile's numbers chooses one of `cells` weights. The source advises a
    power of two of tilings, at least four times the number of signals. Here there are 8, so that
    signals four places apart are displaced alike.
    """

    TILINGS, MEMORY = 8, 48

    def __init__(self, robots: int, senses: Senses, seed: int, **settings: Number) -> None:
        super().__init__(robots, senses, seed, settings)
        if self.inputs > len(_PRIMES):
            raise InputError(f"at most {len(_PRIMES)} signals have tiles, got {self.inputs}")
        setting, self.cells = self.setting, int(settings["cells"])
        self._rate = setting["rate"] / self.TILINGS
        # Tiles that cover a signal; dimensions: robots, tilings, signals.
        self._tiles = torch.as_tensor(setting["tiles"]).view(-1, 1, 1)
        count, cells = len(ACTIONS), self.TILINGS * self.cells
        self.values = self.keep("values", torch.zeros(robots, count * cells), learned=True)
        self.values += column(setting["initial"]) / self.TILINGS
        order = torch.rand(robots, count, generator=self.generator)
        self._order = self.keep("order", order, learned=True)
        offsets = torch.arange(self.TILINGS)[:, None] * (2 * torch.arange(self.inputs) + 1)
        self._offsets = (offsets % self.TILINGS) / self.TILINGS
        width = self._tiles.long() + 1
        dense = width**self.inputs <= self.cells
        primes = torch.tensor(_PRIMES)[: self.inputs]
        self._factors = torch.where(dense, width ** torch.arange(self.inputs), primes)
        self._hashed = ~dense[:, 0]
        self.pair("weights_of", torch.zeros(robots, self.TILINGS, dtype=torch.int64))
        # Indices of the last steps' weights, the latest first, and their traces.
        self._past = self.keep(
            "past", torch.zeros(robots, self.MEMORY, self.TILINGS, dtype=torch.int64)
        )
        self._traces = self.keep("traces", torch.zeros(robots, self.MEMORY, self.TILINGS))
        self._decay = torch.as_tensor(setting["discount"] * setting["trace"]).view(-1, 1, 1)

    def forget_traces(self) -> None:
        self._traces.zero_()

    def tiles(self, inputs: Tensor) -> Tensor:
        """Returns the index in [0, `cells`) of a state's tile in each of T tilings, shape (B, T).

        Args:
          inputs: Signals scaled to [-1, 1], shape (B, I).
        """
        places = (inputs[:, None] + 1) / 2 * self._tiles + self._offsets
        numbers = places.clamp(min=0).minimum(self._tiles + 0.999).long()
        cells = (numbers * self._factors).sum(dim=2)
        if self._hashed.any():  # mixed, so that neighbours in two signals do not share a cell
            mixed = cells + _PRIMES[-1] * torch.arange(self.TILINGS)
            mixed = (mixed ^ (mixed >> 15)) * _MIXER & 0xFFFFFFFF
            cells = torch.where(self._hashed, mixed ^ (mixed >> 13), cells)
        return cells % self.cells

    def choose(self, inputs: Tensor, learning: bool) -> Tensor:
        cells = self.tiles(inputs) + torch.arange(self.TILINGS) * self.cells
        size = self.TILINGS * self.cells
        starts = torch.arange(len(ACTIONS)) * size
        every = (starts[:, None] + cells[:, None]).flatten(1)
        values = self.values.gather(1, every).view(self.robots, len(starts), -1).sum(dim=2)
        equal = values == values.amax(dim=1, keepdim=True)
        order = self._order
        if learning:
            order = torch.rand(order.shape, generator=self.generator)
        best = torch.where(equal, order, -1.0).argmax(dim=1)
        chosen = self.epsilon_greedy(best, learning)
        self.now["weights_of"].copy_(chosen[:, None] * size + cells)
        return ACTIONS[chosen]

    def update(self, reward: Tensor) -> None:
        value, following = (
            self.values.gather(1, step["weights_of"]).sum(dim=1) for step in (self.before, self.now)
        )
        error = reward + self.discount * following - value
        taken = self.before["weights_of"]
        replaced = self._past == taken[:, None]
        self._traces.copy_((self._decay * self._traces).masked_fill(replaced, 0).roll(1, dims=1))
        self._past.copy_(self._past.roll(1, dims=1))
        self._past[:, 0], self._traces[:, 0] = taken, 1.0
        moves = (self._rate * error).view(-1, 1, 1) * self._traces
        self.values.scatter_add_(1, self._past.flatten(1), moves.flatten(1))


sarsa_lambda = tunable(
    rate=Setting(0.5, 0.03, 1.0, "learn rate of the sum of the tilings", log=True, each=True),
    discount=Setting(0.9, 0.6, 0.99, "discount of the next value", each=True),
    trace=Setting(0.8, 0.0, 0.9, "lambda: traces decay by discount times lambda", each=True),
    initial=Setting(0.0, 0.0, 5.0, "initial value of every action", each=True),
    epsilon=epsilon(0.05),
    epsilon_steps=epsilon_steps(1.0),
    tiles=Setting(7, 4, 12, "tiles that cover the range of a signal", each=True),
    cells=Setting(512, 64, 16384, "weights of a tiling, which its tiles share", tuned=False),
)(SarsaLambda)
