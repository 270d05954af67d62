"""The creative memory: recalled actions, and ideas made by noise in its connections (section 3)."""

from __future__ import annotations

from collections.abc import Callable

import torch
from torch import Tensor

from .networks import ACTIVATIONS, Networks
from .optimizers import SGD, Optimizer
from .parameters import Parameters
from .step import Step

# Takes a step, its TD error, 1 or 0 for a robot that learns or does not, and the learn rate of the
# evaluation network. Returns the memory's target action, each robot's learn rate, and a factor by
# which all of these rates are multiplied.
Lesson = Callable[[Step, Tensor, Tensor, float], tuple[Tensor, Tensor, float]]


def selected_action(
    before: Step, error: Tensor, learning: Tensor, rate: float
) -> tuple[Tensor, Tensor, float]:
    """Returns the selected action, with the TD error as learn rate, as in the paper.

    Args:
      before: Step at time t.
      error: TD error of the step, shape (B,).
      learning: 1 for a robot that learns, 0 for one that does not, shape (B,).
      rate: Learn rate of the evaluation network.
    """
    del learning, rate  # the TD error is 0 for a robot that does not learn
    return before.action, error, 1.0


class NoisePatterns:
    """Noise patterns, one for each idea: which connections are noisy, and the sign of the noise.

    A pattern has exactly n = round(share * N) of N connections at +noise or -noise, and the
    others at 0; positions and signs are uniform. A pool of `POOL` patterns is drawn at once,
    every idea takes one of them at random, and the pool is redrawn every `LIFETIME` steps. Each
    idea has the distribution of an individual draw, at a tenth of the cost. Two ideas are equal
    with a probability of 1 in `POOL`, more often than individual draws would be.
    """

    POOL = 16384
    LIFETIME = 500

    def __init__(
        self, connections: int, share: float, noise: float, generator: torch.Generator
    ) -> None:
        """Prepares patterns; the first `draw` fills the pool.

        Args:
          connections: Number N of connections.
          share: Share of noisy connections, in [0, 1].
          noise: Magnitude of the noise, which is added to or subtracted from a noisy connection.
          generator: Random stream from which patterns are drawn.
        """
        self.noisy = round(share * connections)
        self.noise = noise
        self._generator = generator
        self._pool = torch.zeros(self.POOL, connections)
        self._age = torch.tensor([self.LIFETIME])

    def draw(self, count: int) -> Tensor:
        """Draws patterns, shape (count, N)."""
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
        """Returns the pool and its age in steps, for a checkpoint."""
        return {"pool": self._pool, "age": self._age}


class CreativeMemory:
    """Networks that map a state to two logistic outputs, the motor values (section 3).

    Attributes:
      networks: The networks, one for each of B robots.
      optimizer: Optimizer of the networks.
      patterns: Source of the noise patterns, one for each idea.
    """

    def __init__(
        self,
        parameters: Parameters,
        robots: int,
        inputs: int,
        generator: torch.Generator,
        optimizer: Callable[[Networks], Optimizer] = SGD,
    ) -> None:
        """Draws the initial networks.

        Args:
          parameters: Parameters of the brain.
          robots: Number B of robots.
          inputs: Number I of network inputs.
          generator: Random stream of the initial weights and of the noise.
          optimizer: Class of the optimizer.
        """
        self._parameters = parameters
        hidden, initial_range = parameters.memory_hidden, parameters.initial_range
        self.networks = Networks(robots, inputs, hidden, 2, initial_range, generator)
        self.networks.activation = ACTIVATIONS[parameters.activation]
        self.optimizer = optimizer(self.networks)
        # Numbers of connections, in the order of a pattern: sensor, motor weights (and biases).
        self._sizes = [hidden * inputs, 2 * hidden]
        if parameters.noise_on_biases:
            self._sizes += [hidden, 2]
        self.patterns = NoisePatterns(
            sum(self._sizes), parameters.noisy_share, parameters.noise, generator
        )

    def ideas(self, state: Tensor, count: int) -> Tensor:
        """Returns ideas: actions of the memory, each with its own noise in the connections.

        Args:
          state: Network inputs, shape (B, I).
          count: Number A of ideas per robot.

        Returns:
          Motor values in [-0.5, 0.5], shape (B, A, 2).
        """
        robots, inputs = state.shape
        hidden_size = self._parameters.memory_hidden
        patterns = self.patterns.draw(robots * count).view(robots, count, -1)
        if self._parameters.keep_main_idea:
            patterns[:, 0] = 0
        noise = patterns.split(self._sizes, dim=-1)
        net = self.networks

        # (W + N) x = W x + N x: adding the sums avoids building the noisy networks.
        main = torch.baddbmm(net.hidden_biases[..., None], net.hidden_weights, state[..., None])
        noise_in = noise[0].reshape(robots, count * hidden_size, inputs)
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
        """Returns the main idea, the action without noise.

        Args:
          state: Network inputs, shape (B, I).

        Returns:
          Motor values in [-0.5, 0.5], shape (B, 2).
        """
        return self.networks.forward(state)[1].sigmoid() - 0.5

    def learn(self, state: Tensor, action: Tensor, rates: Tensor, rate: float = 1.0) -> None:
        """Learns an action by one step of back-propagation on half the squared error.

        Args:
          state: Network inputs, shape (B, I).
          action: Motor values to learn, shape (B, 2).
          rates: Learn rate of each robot, shape (B,); negative to unlearn the action, 0 for a
            robot that does not learn.
          rate: Factor by which all learn rates are multiplied.
        """
        hidden, sums = self.networks.forward(state)
        outputs = sums.sigmoid()
        steps = rates[:, None] * (action + 0.5 - outputs) * outputs * (1 - outputs)
        self.optimizer.ascend(state, hidden, steps, rate, rates)
