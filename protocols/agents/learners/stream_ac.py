"""Stream AC(lambda): an actor and a critic with deep networks, one sample at a time."""

from __future__ import annotations

import torch
import torch.nn.functional as F
from torch import Tensor
from torch.distributions import Normal

from ....controller.senses import Senses
from ..settings import Number, Setting, tunable
from .base import LARGEST, hidden
from .networks import LayeredNetworks, normalised
from .obgd import ObGD, StreamLearner, make_sparse


class StreamAC(StreamLearner):
    """Stream AC(lambda) (Elsayed, Vasan and Mahmood 2024, algorithm 9), continuous actions.

    With the error r + discount V(s') - V(s), `ObGD` moves the critic along the gradient of V(s)
    and the actor along that of log p(a | s) + entropy * sign(error) * H(p). The actor draws each
    motor value, as a share of the largest, from a normal distribution; it is clipped to [-1, 1]. In
    tests, the action is the mean.
    """

    KAPPA_OF_ACTOR = 1.5  # times the critic's kappa, as published (3, 2)

    def __init__(self, robots: int, senses: Senses, seed: int, **settings: Number) -> None:
        super().__init__(robots, senses, seed, settings)
        width, decay = int(self.setting["hidden"]), self.discount * self.setting["trace"]
        self.critic, self.actor = (
            LayeredNetworks(
                robots, (self.features, width, width, outputs), self.generator, normalised
            )
            for outputs in (1, 4)
        )
        for networks in (self.critic, self.actor):
            make_sparse(networks.tensors, self.generator)
        self.critics_descent = ObGD(self.critic, decay, self.setting["kappa"])
        kappa = self.KAPPA_OF_ACTOR * self.setting["kappa"]
        self.actors_descent = ObGD(self.actor, decay, kappa)
        for name, networks, descent in (
            ("critic", self.critic, self.critics_descent),
            ("actor", self.actor, self.actors_descent),
        ):
            self.keep_list(name, networks.tensors, learned=True)
            self.keep_list(f"{name}.traces", networks.views(descent.traces))
        self.pair("action", torch.zeros(robots, 2))

    def forget_traces(self) -> None:
        super().forget_traces()
        self.critics_descent.forget()
        self.actors_descent.forget()

    def choose(self, inputs: Tensor, learning: bool) -> Tensor:
        mean, spread = _distribution(self.actor(self.normal_inputs(inputs, learning)))
        action = mean
        if learning:
            action = mean + spread * torch.randn(mean.shape, generator=self.generator)
        self.now["action"].copy_(action)
        return LARGEST * action.clamp(-1, 1)

    def update(self, reward: Tensor) -> None:
        features, action = self.before["features"], self.before["action"]
        following = self.critic(self.now["features"])[:, 0]
        value, critics = self.critic.differentiated(lambda flat: self.critic(features, flat)[:, 0])
        error = self.scaled_reward(reward) + self.discount * following - value

        def objective(flat: Tensor) -> Tensor:
            policy = Normal(*_distribution(self.actor(features, flat)), validate_args=False)
            bonus = self.setting["entropy"] * error.sign() * policy.entropy().sum(dim=1)
            return policy.log_prob(action).sum(dim=1) + bonus

        _, actors = self.actor.differentiated(objective)
        self.actors_descent.step(actors, error)
        self.critics_descent.step(critics, error)


def _distribution(outputs: Tensor) -> tuple[Tensor, Tensor]:
    """Returns mean and standard deviation of both motors as shares of 0.5, each (B, 2)."""
    mean, sums = outputs.split(2, dim=-1)
    return mean, F.softplus(sums)


stream_ac = tunable(
    discount=Setting(0.99, 0.6, 0.995, "discount of the next value", each=True),
    trace=Setting(0.8, 0.0, 0.95, "lambda: traces decay by discount times lambda", each=True),
    kappa=Setting(
        2.0,
        1.0,
        10.0,
        "factor by which the critic's steps are smaller than the bound; the actor's 1.5 times",
        log=True,
        each=True,
    ),
    entropy=Setting(0.01, 0.001, 0.1, "weight of the policy's entropy", log=True, each=True),
    hidden=hidden("published 128"),
)(StreamAC)
