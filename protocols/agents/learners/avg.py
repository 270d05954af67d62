"""Action Value Gradient: an actor that climbs its critic's gradient, one sample at a time."""

from __future__ import annotations

import math

import torch
import torch.nn.functional as F
from torch import Tensor

from ....controller.senses import Senses
from ..settings import Number, Setting, tunable
from .base import LARGEST, OnlineLearner, hidden
from .networks import LayeredNetworks, of_unit_length
from .running_moments import Moments

_LOG_SPREAD = -20.0, 2.0


class AVG(OnlineLearner):
    """Action Value Gradient, AVG (Vasan, Elsayed, Azimi and others, NeurIPS 2024).

    The action is a = tanh(mean + spread * noise), in units of the largest motor value. Both
    networks learn by Adam without momentum:

        critic: descends ((r + discount (Q(s', a') - entropy log p(a' | s')) - Q(s, a)) / sigma)^2
        actor:  ascends Q(s, a) - entropy log p(a | s) through a, whose noise is fixed

    The last hidden layer is scaled to length 1, signals to mean 0 and variance 1, and sigma is
    the standard deviation of r - entropy log p(a | s) (return-based scaling; a constant discount
    does not change it). As published, sigma is 1 as long as the variance is at most 0.01. The
    action a' is the one that the robot takes; the authors' program draws another. An output is the
    logarithm of the spread; in the authors' program, of the variance. The initial weights of means
    and spreads are orthogonal together; there, each by themselves. In tests, the noise is 0.
    """

    # Gymnasium's value, which the authors use. Without it, the first normalised signals and so the
    # last hidden layer would be exactly 0, and the gradient of scaling it would be boundless.
    PRIOR = 1e-4

    def __init__(self, robots: int, senses: Senses, seed: int, **settings: Number) -> None:
        super().__init__(robots, senses, seed, settings)
        self._entropy = self.setting["entropy"]
        width = int(self.setting["hidden"])
        self.actor, self.critic = (
            LayeredNetworks(
                robots, (fan_in, width, width, fan_out), self.generator,
                last_hidden=of_unit_length,
            )
            for fan_in, fan_out in ((self.inputs, 4), (self.inputs + 2, 1))
        )  # fmt: skip
        self._adams = []
        for name, networks in (("actor", self.actor), ("critic", self.critic)):
            for weights in networks.tensors[::2]:
                make_orthogonal(weights, self.generator)
            rate = self.setting[f"{name}_rate"]
            self._adams.append(self.trained(name, networks, rate, mean_decay=0.0))
        self._signals = Moments(robots, self.inputs, prior=self.PRIOR)
        self._rewards = Moments(robots)
        self.keep_list("signals", self._signals.tensors(), learned=True)
        self.keep_list("rewards", self._rewards.tensors())
        self.pair("noise", torch.zeros(robots, 2))
        self.pair("action", torch.zeros(robots, 2))
        self.pair("log_density", torch.zeros(robots))

    def choose(self, inputs: Tensor, learning: bool) -> Tensor:
        inputs.copy_(self._signals.standardised(inputs, learning, unbiased=False))
        noise = torch.zeros(self.robots, 2)
        if learning:
            noise = torch.randn(noise.shape, generator=self.generator)
        action, log_density = _squashed(self.actor(inputs), noise)
        self.now["noise"].copy_(noise)
        self.now["action"].copy_(action)
        self.now["log_density"].copy_(log_density)
        return LARGEST * action

    def update(self, reward: Tensor) -> None:
        inputs, noise = self.before["inputs"], self.before["noise"]
        taken = torch.cat([inputs, self.before["action"]], dim=1)
        following = torch.cat([self.now["inputs"], self.now["action"]], dim=1)
        self._rewards.add(reward - self._entropy * self.before["log_density"])
        variance = self._rewards.variance(unbiased=False)
        sigma = torch.where(variance > 0.01, variance.sqrt(), 1.0).float()
        soft = self.critic(following)[:, 0] - self._entropy * self.now["log_density"]
        target = reward + self.discount * soft

        def loss(flat: Tensor) -> Tensor:
            return ((target - self.critic(taken, flat)[:, 0]) / sigma).square()

        def cost(flat: Tensor) -> Tensor:
            action, log_density = _squashed(self.actor(inputs, flat), noise)
            value = self.critic(torch.cat([inputs, action], dim=1))[:, 0]
            return self._entropy * log_density - value

        for adam, objective in zip(self._adams, (cost, loss), strict=True):
            adam.descend(objective)  # the critic last: the actor's cost depends on it


def _squashed(outputs: Tensor, noise: Tensor) -> tuple[Tensor, Tensor]:
    """Returns the action tanh(mean + spread * noise) and its log density, shapes (B, 2) and (B,).

    Args:
      outputs: Both motors' means, then the logarithms of their standard deviations, shape (B, 4).
      noise: Standard normal numbers, shape (B, 2).
    """
    mean, log_spread = outputs.split(2, dim=1)
    log_spread = log_spread.clamp(*_LOG_SPREAD)
    before = mean + log_spread.exp() * noise
    normal = -0.5 * noise.square() - log_spread - 0.5 * math.log(2 * math.pi)
    # log(1 - tanh(u)^2), u = `before`, without loss of digits at large u.
    slope = 2 * (math.log(2) - before - F.softplus(-2 * before))
    return before.tanh(), (normal - slope).sum(dim=1)


def make_orthogonal(weights: Tensor, generator: torch.Generator) -> None:
    """Draws orthogonal weights into `weights` (B, O, I), as `torch.nn.init.orthogonal_` does."""
    robots, rows, columns = weights.shape
    tall = torch.randn(robots, max(rows, columns), min(rows, columns), generator=generator)
    q, r = torch.linalg.qr(tall)
    q *= r.diagonal(dim1=-2, dim2=-1).sign()[:, None]
    weights.copy_(q if rows >= columns else q.mT)


avg = tunable(
    discount=Setting(0.99, 0.6, 0.995, "discount of the next value", each=True),
    actor_rate=Setting(0.0063, 1e-5, 1e-2, "learn rate of the actor", log=True, each=True),
    critic_rate=Setting(0.0087, 1e-5, 1e-2, "learn rate of the critic", log=True, each=True),
    entropy=Setting(0.07, 0.001, 0.5, "weight of the policy's entropy", log=True, each=True),
    hidden=hidden("published 256"),
)(AVG)
