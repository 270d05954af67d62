"""What stream Q and stream AC share: bounded steps, sparse weights, normalised signals.

Elsayed, Vasan and Mahmood, "Streaming Deep Reinforcement Learning Finally Works",
arXiv:2410.14606, 2024.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import torch
from torch import Tensor

from ....controller.senses import Senses
from ..settings import Number
from .base import OnlineLearner
from .networks import LayeredNetworks, column
from .running_moments import Moments


class ObGD:
    """Overshooting-bounded gradient descent with eligibility traces (Elsayed 2024, algorithm 3).

    With an eligibility trace z of each weight, z <- decay * z + gradient, the weights move by

        step * error * z,   step = 1 / max(1, kappa * max(|error|, 1) * sum |z|)

    where the sum is over all weights of a robot. The decay is the discount times lambda (setting
    `trace`). `decay` and `kappa` are numbers, or tensors with one for each robot, shape (B,).

    Attributes:
      traces: Eligibility trace of each weight, shape (B, W).
    """

    def __init__(
        self, networks: LayeredNetworks, decay: float | Tensor, kappa: float | Tensor
    ) -> None:
        self._flat, self._decay, self._kappa = networks.flat, column(decay), kappa
        self.traces = torch.zeros_like(self._flat)

    def step(self, gradient: Tensor, error: Tensor) -> None:
        """Moves weights along their traces, given each robot's TD error (B,).

        `gradient` (B, W) is that of the quantity which a positive error increases.
        """
        self.traces.mul_(self._decay).add_(gradient)
        length = self.traces.abs().sum(dim=1)
        bound = self._kappa * error.abs().clamp(min=1) * length
        self._flat += (1 / bound.clamp(min=1) * error)[:, None] * self.traces

    def forget(self, robots: Tensor | None = None) -> None:
        """Sets the traces of robots to 0 where the mask `robots`, (B,), is true; None for all."""
        # Robots' indices: indexing with the mask takes thirty times longer.
        self.traces[slice(None) if robots is None else robots.nonzero()[:, 0]] = 0


def make_sparse(tensors: Sequence[Tensor], generator: torch.Generator) -> None:
    """Sets 90 % of each neuron's incoming weights to 0 (Elsayed 2024, algorithm 1).

    At least one weight of each neuron stays. The published rule rounds the number of zeros up: a
    neuron with fewer than ten inputs would have no weight. Our robots have one to seven signals.
    In `tensors`, weights (B, O, I) and biases of the layers alternate; they change in place.
    """
    for weights in tensors[::2]:
        fan_in = weights.shape[-1]
        zeros = min(math.ceil(0.9 * fan_in), fan_in - 1)
        rank = torch.rand(weights.shape, generator=generator).argsort(dim=-1)
        weights[rank < zeros] = 0


class StreamLearner(OnlineLearner):
    """A learner whose signals and rewards are normalised by their running moments.

    These are algorithms 5 and 6 of Elsayed (2024). As in the authors' program, the variance of the
    discounted sum of rewards is about its running mean. The moments are updated in training only,
    so that tests change nothing. The source has the time in the episode as a further input. Here it
    is always 1, since lives have no episodes and robots no clock. Without it, with one signal and
    biases of 0, a normalised layer would depend on the signal's sign only.

    Attributes:
      features: Number of a network's inputs: the signals and a constant 1.
    """

    def __init__(
        self, robots: int, senses: Senses, seed: int, settings: Mapping[str, Number]
    ) -> None:
        super().__init__(robots, senses, seed, settings)
        self.features = self.inputs + 1
        self.pair("features", torch.ones(self.robots, self.features))
        self._signals, self._rewards = Moments(self.robots, self.inputs), Moments(self.robots)
        self.keep_list("signals", self._signals.tensors(), learned=True)
        self.keep_list("rewards", self._rewards.tensors())
        self._trace = self.keep("rewards.trace", torch.zeros(self.robots, dtype=torch.float64))

    def forget_traces(self) -> None:
        self._trace.zero_()

    def normal_inputs(self, inputs: Tensor, learning: bool) -> Tensor:
        """Returns this step's features: signals normalised to mean 0 and variance 1, and a 1."""
        self.now["features"][:, :-1] = self._signals.standardised(inputs, learning)
        return self.now["features"]

    def scaled_reward(self, reward: Tensor) -> Tensor:
        """Returns the reward divided by the standard deviation of the discounted sum of rewards."""
        self._trace.mul_(self.discount).add_(reward)
        self._rewards.add(self._trace)
        return (reward / self._rewards.deviation()).float()
