"""Methods of the literature, each added alone to `dqn_no_replay`.

The first three act against the loss of plasticity. Reward centring removes the rewards' mean.
"""

from __future__ import annotations

import torch
from torch import Tensor

from ....controller.senses import Senses
from ..settings import Number, Setting, tunable
from .dqn import SETTINGS, DQNWithoutReplay
from .networks import column

# Below 3e-7 a single-precision weight hardly changes.
_DECAY = Setting(1e-6, 3e-7, 1e-3, "share of each weight that a step takes", log=True, each=True)


class ShrinkAndPerturb(DQNWithoutReplay):
    """DQN without replay whose weights shrink and receive noise in each step.

    Shrink and perturb (Ash and Adams, "On warm-starting neural network training", NeurIPS 2020) in
    the online form of Dohare et al. ("Loss of plasticity in deep continual learning", Nature 632,
    2024). Without the setting `noise`, it is decoupled weight decay (Loshchilov and Hutter,
    "Decoupled weight decay regularization", ICLR 2019), which differs from an L2 term in the loss:
    Adam does not scale it. Biases decay, too. The decay does not depend on the learn rate.
    """

    def update(self, reward: Tensor) -> None:
        super().update(reward)
        weights = self.networks.flat
        weights.mul_(1 - column(self.setting["decay"]))
        if "noise" in self.setting:
            noise = torch.randn(weights.shape, generator=self.generator)
            weights.add_(column(self.setting["noise"]) * noise)


class ContinualBackprop(DQNWithoutReplay):
    """DQN without replay that replaces its least useful hidden neurons, a few at a time.

    Continual backpropagation (Dohare et al., Nature 632, 2024, Algorithm 1): the utility of a
    neuron is a running mean of its absolute activation times the sum of its absolute outgoing
    weights. In each step and hidden layer, the share `replaced` of the neurons older than `MATURE`
    steps is replaced: incoming weights are drawn as at birth, bias and outgoing weights set to 0.
    Unlike in the authors' program, Adam's moments are kept, a young neuron's utility is not
    corrected for its age, and the mean activation of a removed neuron is not added to the biases
    of the next layer.
    """

    MATURE, UTILITY_DECAY = 1000, 0.99

    def __init__(self, robots: int, senses: Senses, seed: int, **settings: Number) -> None:
        super().__init__(robots, senses, seed, **settings)
        shape = 2, robots, int(self.setting["hidden"])  # of both hidden layers
        self._utility = self.keep("utility", torch.zeros(shape))
        self._ages = self.keep("ages", torch.zeros(shape))
        self._due = self.keep("due", torch.zeros(shape[:2]))

    def update(self, reward: Tensor) -> None:
        super().update(reward)
        self._ages += 1
        layers = self.networks.layers(self.before["inputs"][:, None])
        for layer, hidden in enumerate(layers[1:-1]):
            outgoing = self.networks.tensors[2 * layer + 2]
            useful = hidden[:, 0].abs() * outgoing.abs().sum(dim=1)
            self._utility[layer].lerp_(useful, 1 - self.UTILITY_DECAY)
            mature = self._ages[layer] > self.MATURE
            self._due[layer] += self.setting["replaced"] * mature.sum(dim=1)
            robots = torch.nonzero(self._due[layer] >= 1)[:, 0]
            if len(robots):
                self._due[layer, robots] -= 1
                least = self._utility[layer].where(mature, torch.inf)[robots].argmin(dim=1)
                self._replace(layer, robots, least)

    def _replace(self, layer: int, robots: Tensor, neurons: Tensor) -> None:
        """Gives new weights to neuron `neurons[i]` of robot `robots[i]` in a layer; shapes (n,)."""
        ingoing, biases, outgoing = self.networks.tensors[2 * layer : 2 * layer + 3]
        width = ingoing.shape[2]
        drawn = torch.rand(len(robots), width, generator=self.generator) * 2 - 1
        ingoing[robots, neurons] = drawn / width**0.5
        biases[robots, neurons] = 0
        outgoing[robots, :, neurons] = 0
        self._utility[layer, robots, neurons] = 0
        self._ages[layer, robots, neurons] = 0


class CentredDQN(DQNWithoutReplay):
    """DQN without replay that learns from rewards minus their running mean.

    Reward centering (Naik et al., "Reward centering", RLC 2024, section 2: simple centering, which
    the source uses for on-policy learning; for Q-learning it takes the mean from TD errors).
    """

    def __init__(self, robots: int, senses: Senses, seed: int, **settings: Number) -> None:
        super().__init__(robots, senses, seed, **settings)
        self._mean = self.keep("mean", torch.zeros(robots))

    def update(self, reward: Tensor) -> None:
        centred = reward - self._mean
        self._mean += self.setting["pace"] * centred
        super().update(centred)


dqn_l2 = tunable(**SETTINGS, decay=_DECAY)(ShrinkAndPerturb)

dqn_shrink_perturb = tunable(
    **SETTINGS,
    decay=_DECAY,
    noise=Setting(1e-5, 1e-7, 1e-3, "noise in a step, SD", log=True, each=True),
)(ShrinkAndPerturb)

dqn_continual = tunable(
    **SETTINGS,
    replaced=Setting(1e-5, 1e-7, 1e-3, "share of mature neurons in a step", log=True, each=True),
)(ContinualBackprop)

dqn_centred = tunable(
    **SETTINGS,
    pace=Setting(1e-3, 1e-5, 0.1, "share of a reward in its mean", log=True, each=True),
)(CentredDQN)
