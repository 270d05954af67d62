"""The creative memory: past actions recalled, and new ideas from noise in its connections."""

from __future__ import annotations

import torch
from torch import Tensor

from .networks import Networks
from .optimizers import make_optimizer
from .parameters import Parameters


class NoisePatterns:
    """Which connections of an idea are noisy, and with which sign.

    A pattern has exactly n = round(share * N) of N connections at +noise or -noise, and 0
    elsewhere; positions and signs are uniform. A large pool of patterns is drawn at once,
    every idea takes one of it at random, and the pool is drawn anew every `LIFETIME` steps.
    Each idea has the distribution of a draw of its own, at a tenth of the cost; two ideas are
    the same with a probability of one in 16384, which a draw of their own would not grant.
    """

    POOL = 16384
    LIFETIME = 500

    def __init__(
        self, connections: int, share: float, noise: float, generator: torch.Generator
    ) -> None:
        """Prepares patterns for N connections; the pool is drawn at the first `draw`."""
        self.noisy = round(share * connections)
        self.noise = noise
        self._generator = generator
        self._pool = torch.zeros(self.POOL, connections)
        self._age = torch.tensor([self.LIFETIME])

    def draw(self, count: int) -> Tensor:
        """Returns patterns, shape (count, N)."""
        if self._age >= self.LIFETIME:
            self._refill()
        self._age += 1
        rows = torch.randint(self.POOL, (count,), generator=self._generator)
        return self._pool.index_select(0, rows)

    def _refill(self) -> None:
        keys = torch.rand(self._pool.shape, generator=self._generator)
        chosen = keys.argsort(dim=1)[:, : self.noisy]
        signs = torch.randint(2, chosen.shape, generator=self._generator) * 2.0 - 1.0
        self._pool.zero_().scatter_(1, chosen, self.noise * signs)
        self._age.zero_()

    def tensors(self) -> dict[str, Tensor]:
        """The pool and its age, for a checkpoint."""
        return {"pool": self._pool, "age": self._age}


class CreativeMemory:
    """Sensors in, one layer of hidden neurons, two logistic outputs: the motors (section 3)."""

    def __init__(
        self, parameters: Parameters, robots: int, sensors: int, generator: torch.Generator
    ) -> None:
        """Draws B networks for states of S sensors."""
        self._parameters = parameters
        hidden = parameters.memory_hidden
        self.networks = Networks(
            robots,
            sensors,
            hidden,
            2,
            parameters.initial_range,
            generator,
            parameters.activation,
        )
        # A TD error says how far to go: Adam, which levels the steps, would not hear it.
        towards_best = parameters.memory_goal == "best"
        self.optimizer = make_optimizer(
            parameters.optimizer if towards_best else "plain", self.networks
        )
        # Connections of an idea side by side: sensor weights, motor weights (and biases).
        self._sizes = [hidden * sensors, 2 * hidden]
        if parameters.noise_on_biases:
            self._sizes += [hidden, 2]
        self.patterns = NoisePatterns(
            sum(self._sizes), parameters.noisy_share, parameters.noise, generator
        )

    def ideas(self, state: Tensor) -> Tensor:
        """Actions that the memory proposes in a state, each under noise of its own.

        Args:
          state: sensor signals, shape (B, S).

        Returns:
          Motor values in [-0.5, 0.5], shape (B, A, 2).
        """
        robots, sensors = state.shape
        hidden_size = self._parameters.memory_hidden
        count = self._parameters.ideas - self._parameters.random_ideas
        patterns = self.patterns.draw(robots * count).view(robots, count, -1)
        if self._parameters.keep_main_idea:
            patterns[:, 0] = 0
        noise = patterns.split(self._sizes, dim=-1)
        net = self.networks

        # Noise and weights add: (W + N) x = W x + N x, so no noisy network is ever built.
        main = torch.baddbmm(net.hidden_biases[..., None], net.hidden_weights, state[..., None])
        noise_in = noise[0].reshape(robots, count * hidden_size, sensors)
        sums = torch.bmm(noise_in, state[..., None]).view(robots, count, hidden_size)
        sums += main.mT
        if self._parameters.noise_on_biases:
            sums += noise[2]
        hidden = net.activation.apply(sums)

        outputs = torch.baddbmm(net.output_biases[:, None], hidden, net.output_weights.mT)
        noise_out = noise[1].view(robots, count, 2, hidden_size)
        outputs += (noise_out * hidden[:, :, None]).sum(-1)
        if self._parameters.noise_on_biases:
            outputs += noise[3]
        return outputs.sigmoid_() - 0.5

    def recall(self, state: Tensor) -> Tensor:
        """The main idea, without noise: motor values, shape (B, 2), for a state (B, S)."""
        return self.networks.forward(state)[1].sigmoid() - 0.5

    def learn(self, state: Tensor, action: Tensor, rates: Tensor, rate: float = 1.0) -> None:
        """One step of back-propagation towards an action, down half the squared error.

        Args:
          state: sensor signals, shape (B, S).
          action: the motor values to remember, shape (B, 2).
          rates: each robot's learn rate, shape (B,): towards a selected action the TD error
            (negative: to unlearn), towards the best one 1; 0 for a robot that does not learn.
          rate: everybody's, by which these are multiplied.
        """
        hidden, sums = self.networks.forward(state)
        outputs = sums.sigmoid()
        steps = rates[:, None] * (action + 0.5 - outputs) * outputs * (1 - outputs)
        self.optimizer.ascend(state, hidden, steps, rate, rates)
