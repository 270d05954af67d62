"""Beyond the paper: a recurrent context, whose units are further inputs of both networks."""

from __future__ import annotations

import math

import torch
from torch import Tensor


class EchoContext:
    """C recurrent units per robot that remember past signals, by fixed random connections.

    In each control step, after the action was selected, the units follow

        x_i <- x_i + r_i (tanh(sum over j of W_ij x_j + sum over k of U_ik s_k) - x_i)

    with the network inputs s of that step. So both networks receive what was sensed before the
    present step. The rates r_i are spaced logarithmically from `FASTEST` to `SLOWEST`: time
    constants of 0.2 s to 20 s with control steps of 0.1 s. W and U are drawn uniformly from [-1, 1]
    and never learn; W is scaled to the spectral radius `RADIUS`, U by 1 / sqrt(I).

    Sources: Jaeger, "The 'echo state' approach to analysing and training recurrent neural
    networks", GMD Report 148 (2001); units with rates of their own: Jaeger, Lukosevicius, Popovici
    and Siewert, Neural Networks 20 (2007). The rates and the scale of U are ours.

    Attributes:
      values: Values x of the units, shape (B, C); 0 before the first step.
    """

    RADIUS = 0.9
    FASTEST, SLOWEST = 0.5, 0.005

    def __init__(self, robots: int, inputs: int, units: int, generator: torch.Generator) -> None:
        """Draws the connections.

        Args:
          robots: Number B of robots.
          inputs: Number I of network inputs without the context.
          units: Number C of context units.
          generator: Random stream from which the connections are drawn.
        """
        self.values = torch.zeros(robots, units)
        recurrent = torch.rand(robots, units, units, generator=generator) * 2 - 1
        radius = torch.linalg.eigvals(recurrent).abs().amax(dim=1)
        self._recurrent = recurrent * (self.RADIUS / radius)[:, None, None]
        self._forward = torch.rand(robots, units, inputs, generator=generator) * 2 - 1
        self._forward /= inputs**0.5
        first, last = math.log10(self.FASTEST), math.log10(self.SLOWEST)
        self._rates = torch.logspace(first, last, units)

    def joined(self, inputs: Tensor) -> Tensor:
        """Returns one array, shape (B, I + C): the inputs, shape (B, I), then the units' values."""
        return torch.cat([inputs, self.values], dim=1)

    def advance(self, inputs: Tensor) -> None:
        """Updates the units at the end of a step.

        Args:
          inputs: Network inputs of the step without the context, shape (B, I).
        """
        sums = self._recurrent @ self.values[..., None] + self._forward @ inputs[..., None]
        self.values += self._rates * (sums[..., 0].tanh() - self.values)

    def weights(self) -> dict[str, Tensor]:
        """Returns the connections themselves, not copies, by name."""
        return {"recurrent_weights": self._recurrent, "input_weights": self._forward}

    def tensors(self) -> dict[str, Tensor]:
        """Returns the values of the units, not a copy, for a checkpoint."""
        return {"values": self.values}
