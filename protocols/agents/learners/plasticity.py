"""Ingredients against the loss of plasticity, each added alone to `q_learner`."""

from __future__ import annotations

import torch
from torch import Tensor

from ....controller.senses import Senses
from ..base import Agent
from ..settings import Number, Setting, tunable
from .networks import column
from .q_learning import SETTINGS, QLearner

_DECAY = Setting(
    1e-5, 1e-7, 1e-3, "share of each weight that a step takes away", log=True, each=True
)


class ShrinkAndPerturb(QLearner):
    """Q-learning whose weights shrink and receive noise in each step.

    Shrink and perturb (Ash and Adams, "On warm-starting neural network training", NeurIPS 2020) in
    the online form of Dohare et al. ("Loss of plasticity in deep continual learning", Nature 632,
    2024). Without the setting `noise` it is L2 regularisation towards zero.
    """

    def update(self, reward: Tensor) -> None:
        super().update(reward)
        weights = self._networks.weights
        weights.mul_(1 - column(self.setting["decay"]))
        if "noise" in self.setting:
            noise = torch.randn(weights.shape, generator=self.generator)
            weights.add_(column(self.setting["noise"]) * noise)


class ContinualBackprop(QLearner):
    """Q-learning in which the least useful hidden neurons are born again, a few at a time.

    Continual backpropagation (Dohare et al., Nature 632, 2024, Algorithm 1): the utility of a
    neuron is a running mean of its activation times the sum of its outgoing weights, both
    absolute. Of the neurons that are older than `MATURE` steps the share `replaced` is replaced in
    each step: ingoing weights are drawn as those of a newborn, outgoing ones are 0.
    """

    MATURE, UTILITY_DECAY = 1000, 0.99

    def __init__(self, robots: int, senses: Senses, seed: int, **settings: Number) -> None:
        super().__init__(robots, senses, seed, **settings)
        self._utility = self.keep("utility", torch.zeros(robots, self.HIDDEN))
        self._ages = self.keep("ages", torch.zeros(robots, self.HIDDEN))
        self._due = self.keep("due", torch.zeros(robots))

    def update(self, reward: Tensor) -> None:
        super().update(reward)
        networks = self._networks
        hidden = networks.forward(self.before["inputs"])[0]
        useful = hidden.abs() * networks.output_weights.abs().sum(dim=1)
        self._utility.lerp_(useful, 1 - self.UTILITY_DECAY)
        self._ages += 1
        mature = self._ages > self.MATURE
        self._due += self.setting["replaced"] * mature.sum(dim=1)
        robots = torch.nonzero(self._due >= 1)[:, 0]
        if len(robots):
            self._due[robots] -= 1
            neurons = self._utility.where(mature, torch.inf)[robots].argmin(dim=1)
            self._replace(robots, neurons)

    def _replace(self, robots: Tensor, neurons: Tensor) -> None:
        """Gives one hidden neuron of some robots, shapes (n,), the weights of a newborn."""
        networks = self._networks
        drawn = torch.rand(len(robots), self.inputs + 1, generator=self.generator) * 2 - 1
        drawn *= self.INITIAL
        networks.hidden_weights[robots, neurons] = drawn[:, :-1]
        networks.hidden_biases[robots, neurons] = drawn[:, -1]
        networks.output_weights[robots, :, neurons] = 0
        self._utility[robots, neurons] = 0
        self._ages[robots, neurons] = 0


class CentredQLearner(QLearner):
    """Q-learning from rewards less their mean.

    Reward centering (Naik et al., "Reward centering", RLC 2024, section 3, value-based form): the
    mean reward follows the error of the values, as they do, with the learn rate times `pace`.
    """

    def __init__(self, robots: int, senses: Senses, seed: int, **settings: Number) -> None:
        super().__init__(robots, senses, seed, **settings)
        self._mean = self.keep("mean", torch.zeros(robots))

    def update(self, reward: Tensor) -> None:
        error = self.learn_values(reward - self._mean)
        self._mean += self.setting["pace"] * self.setting["rate"] * error


@tunable(**SETTINGS, decay=_DECAY)
def q_l2(robots: int, senses: Senses, seed: int, **settings: Number) -> Agent:
    """`q_learner` with L2 regularisation towards zero."""
    return ShrinkAndPerturb(robots, senses, seed, **settings)


@tunable(
    **SETTINGS,
    decay=_DECAY,
    noise=Setting(1e-4, 1e-6, 1e-2, "noise in a step, SD", log=True, each=True),
)
def q_shrink_perturb(robots: int, senses: Senses, seed: int, **settings: Number) -> Agent:
    """`q_learner` with weights that shrink and receive noise (Ash and Adams 2020)."""
    return ShrinkAndPerturb(robots, senses, seed, **settings)


@tunable(
    **SETTINGS,
    replaced=Setting(1e-5, 1e-7, 1e-3, "share of mature neurons in a step", log=True, each=True),
)
def q_continual(robots: int, senses: Senses, seed: int, **settings: Number) -> Agent:
    """`q_learner` with continual backpropagation (Dohare and others 2024)."""
    return ContinualBackprop(robots, senses, seed, **settings)


@tunable(
    **SETTINGS,
    pace=Setting(
        0.1, 0.001, 1.0, "learn rate of the mean reward over that of values", log=True, each=True
    ),
)
def q_centred(robots: int, senses: Senses, seed: int, **settings: Number) -> Agent:
    """`q_learner` with reward centring (Naik and others 2024)."""
    return CentredQLearner(robots, senses, seed, **settings)
