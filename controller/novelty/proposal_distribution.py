"""A learned distribution of proposed actions, in place of the creative memory."""

from __future__ import annotations

from collections.abc import Callable, Mapping

import torch
from torch import Tensor

from ..networks import ACTIVATIONS, Networks
from ..optimizers import SGD, Optimizer, Rate
from ..parameters import Parameters


class ProposalDistribution:
    """Networks that map a state to a normal distribution of motor values.

    A network has four outputs o. The mean of a motor is mu = logistic(o) - 1/2, as the creative
    memory's action, and its standard deviation sigma = `SMALLEST` + (`LARGEST` - `SMALLEST`)
    logistic(o'). Ideas are drawn from it and clipped to [-0.5, 0.5]. It learns the best a* of the
    proposed actions by gradient ascent on

        log p(a* | s) + `ENTROPY` H(p) = sum over motors of
            -(a* - mu)^2 / (2 sigma^2) - (1 - `ENTROPY`) log sigma + constant

    as amortised Q-learning does (Van de Wiele, Warde-Farley, Mnih and Mnih, arXiv:2001.08116,
    2020), where the actions to choose from are partly uniform, partly the distribution's own:
    `Parameters.random_share` sets the uniform part. Without it the distribution sees only its own
    actions; the entropy keeps it from collapsing. Ours are the diagonal normal distribution, the
    bounds of sigma and the weight of the entropy. The candidates are distinct, but for those that
    are clipped to the same corner.

    Attributes:
      networks: The networks, one for each of B robots.
      optimizer: Optimizer of the networks.
    """

    SMALLEST, LARGEST = 0.05, 0.5
    ENTROPY = 0.1

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
          generator: Random stream of the initial weights and of the draws.
          optimizer: Class of the optimizer.
        """
        hidden, initial_range = parameters.memory_hidden, parameters.initial_range
        self.networks = Networks(robots, inputs, hidden, 4, initial_range, generator)
        self.networks.activation = ACTIVATIONS[parameters.activation]
        self.optimizer = optimizer(self.networks)
        self._generator = generator

    def distribution(self, state: Tensor) -> tuple[Tensor, Tensor]:
        """Returns mean and standard deviation of both motors, each of shape (B, 2).

        Args:
          state: Network inputs, shape (B, I).
        """
        mean, spread = self.networks.forward(state)[1].sigmoid().split(2, dim=1)
        return mean - 0.5, self.SMALLEST + (self.LARGEST - self.SMALLEST) * spread

    def renew(self) -> None:
        """See `Memory.renew`; all draws are those of one step."""

    def ideas(self, state: Tensor, count: int) -> Tensor:
        """Returns actions drawn from the distribution, motor values of shape (B, A, 2).

        Args:
          state: Network inputs, shape (B, I).
          count: Number A of actions per robot.
        """
        mean, spread = self.distribution(state)
        size = len(state), count, 2
        normals = torch.randn(size, generator=self._generator, device=state.device)
        return (mean[:, None] + spread[:, None] * normals).clamp(-0.5, 0.5)

    def recall(self, state: Tensor) -> Tensor:
        """Returns the mean of the distribution, motor values of shape (B, 2).

        Args:
          state: Network inputs, shape (B, I).
        """
        return self.distribution(state)[0]

    def learn(self, state: Tensor, action: Tensor, factors: Tensor, rate: Rate = 1.0) -> None:
        """Learns an action by one step of gradient ascent on the objective of this class.

        Args:
          state: Network inputs, shape (B, I).
          action: Motor values to learn, shape (B, 2).
          factors: 1 for a robot that learns, 0 for one that does not, shape (B,).
          rate: Learn rate.
        """
        hidden, sums = self.networks.forward(state)
        share = sums.sigmoid()
        slope = share * (1 - share)
        spread = self.SMALLEST + (self.LARGEST - self.SMALLEST) * share[:, 2:]
        apart = (action + 0.5 - share[:, :2]) / spread
        by_spread = (apart * apart - 1 + self.ENTROPY) * (self.LARGEST - self.SMALLEST)
        steps = slope * torch.cat([apart, by_spread], dim=1) / spread.repeat(1, 2)
        self.optimizer.ascend(state, hidden, factors[:, None] * steps, rate, factors)

    def weights(self) -> Mapping[str, Tensor]:
        """Returns the weights and biases themselves, not copies, by name."""
        return self.networks.tensors()

    def tensors(self) -> Mapping[str, Tensor]:
        """Returns no further tensors for a checkpoint."""
        return {}
