"""Amortised Q-learning: a learned proposer, the closest relative of the creative memory."""

from __future__ import annotations

import torch
import torch.nn.functional as F
from torch import Tensor
from torch.distributions import Normal

from ....controller.senses import Senses
from ..settings import Number, Setting, tunable
from .base import LARGEST, OnlineLearner, epsilon, epsilon_steps, hidden
from .networks import LayeredNetworks, column


class AmortisedQ(OnlineLearner):
    """Amortised Q-learning (Van de Wiele, Warde-Farley, Mnih, Mnih, arXiv:2001.08116, 2020).

    The maximum of Q-learning is over 25 candidates: `OWN` actions drawn from the distribution of a
    second network, the proposer, and `UNIFORM` uniform ones. The proposer ascends
    log p(a* | s) + entropy * H(p), where a* is the best candidate and H(p) the entropy of p
    (section 3 of the source). It draws each motor value, as a share of the largest, from a normal
    distribution and clips it to [-1, 1]. Unlike the source, this learner has no parallel actors,
    replay or target network. It also has 25 candidates instead of 100 own and 400 uniform ones,
    smaller networks with tanh, and motor values drawn independently, not one after the other. As in
    the source, candidates are random in tests, too.
    """

    OWN, UNIFORM = 17, 8  # in all 25, the paper's number of actions
    SPREADS = 0.1, 1.0  # smallest and largest standard deviation

    def __init__(self, robots: int, senses: Senses, seed: int, **settings: Number) -> None:
        super().__init__(robots, senses, seed, settings)
        width = int(self.setting["hidden"])
        sizes = (self.inputs + 2, width, width, 1), (self.inputs, width, width, 4)
        self.values, self.proposer = (
            LayeredNetworks(robots, shape, self.generator, F.tanh) for shape in sizes
        )
        self._adams = [
            self.trained("values", self.values, self.setting["rate"]),
            self.trained("proposer", self.proposer, self.setting["proposer_rate"]),
        ]
        for name in ("action", "best"):
            self.pair(name, torch.zeros(robots, 2))
        self.pair("value_of_best", torch.zeros(robots))

    def choose(self, inputs: Tensor, learning: bool) -> Tensor:
        mean, spread = self._distribution(self.proposer(inputs))
        normals = torch.randn(self.robots, self.OWN, 2, generator=self.generator)
        own = (mean[:, None] + spread[:, None] * normals).clamp(-1, 1)
        uniform = torch.rand(self.robots, self.UNIFORM, 2, generator=self.generator) * 2 - 1
        actions = torch.cat([own, uniform], dim=1)
        states = inputs[:, None].expand(-1, actions.shape[1], -1)
        values = self.values(torch.cat([states, actions], dim=2))[..., 0]
        rows = torch.arange(self.robots)
        best = values.argmax(dim=1)
        self.now["best"].copy_(actions[rows, best])
        self.now["value_of_best"].copy_(values[rows, best])
        self.now["action"].copy_(self.now["best"])
        if learning:  # the last candidate is uniform, as an exploratory action must be
            self.now["action"][:] = torch.where(
                self.draw_exploratory()[:, None], actions[:, -1], self.now["best"]
            )
        return LARGEST * self.now["action"]

    def update(self, reward: Tensor) -> None:
        inputs = self.before["inputs"]
        taken = torch.cat([inputs, self.before["action"]], dim=1)
        target = reward + self.discount * self.now["value_of_best"]

        def loss(flat: Tensor) -> Tensor:
            return 0.5 * (target - self.values(taken, flat)[:, 0]).square()

        entropy = column(self.setting["entropy"])

        def cost(flat: Tensor) -> Tensor:
            distribution = self._distribution(self.proposer(inputs, flat))
            proposals = Normal(*distribution, validate_args=False)
            gain = proposals.log_prob(self.before["best"]) + entropy * proposals.entropy()
            return -gain.sum(dim=1)

        for adam, objective in zip(self._adams, (loss, cost), strict=True):
            adam.descend(objective)

    def _distribution(self, outputs: Tensor) -> tuple[Tensor, Tensor]:
        """Returns mean and standard deviation of both motors as shares of 0.5, each (B, 2)."""
        mean, sums = outputs.split(2, dim=-1)
        low, high = self.SPREADS
        return mean.tanh(), low + (high - low) * sums.sigmoid()


amortised_q = tunable(
    rate=Setting(0.001, 1e-4, 1e-2, "learn rate of the values", log=True, each=True),
    proposer_rate=Setting(0.001, 1e-4, 1e-2, "learn rate of the proposals", log=True, each=True),
    discount=Setting(0.9, 0.6, 0.99, "discount of the next value", each=True),
    epsilon=epsilon(0.05),
    epsilon_steps=epsilon_steps(1.0),
    entropy=Setting(0.1, 0.01, 1.0, "weight of the proposals' entropy", log=True, each=True),
    hidden=hidden(),
)(AmortisedQ)
