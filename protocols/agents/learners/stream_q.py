"""Stream Q(lambda): Q-learning with deep networks, one sample at a time."""

from __future__ import annotations

import torch
from torch import Tensor

from ....controller.senses import Senses
from ..settings import Number, Setting, tunable
from .base import ACTIONS, epsilon, epsilon_steps, hidden
from .networks import LayeredNetworks, normalised
from .obgd import ObGD, StreamLearner, make_sparse


class StreamQ(StreamLearner):
    """Stream Q(lambda) (Elsayed, Vasan and Mahmood 2024, algorithm 8) with the 25 fixed actions.

    The error r + discount max Q(s', .) - Q(s, a) moves the weights by `ObGD`; traces are set to 0
    after an exploratory action (Watkins). Epsilon falls linearly from 1 to the setting `epsilon`.
    """

    def __init__(self, robots: int, senses: Senses, seed: int, **settings: Number) -> None:
        super().__init__(robots, senses, seed, settings)
        width, outputs = int(self.setting["hidden"]), len(ACTIONS)
        sizes = (self.features, width, width, outputs)
        self.networks = LayeredNetworks(robots, sizes, self.generator, normalised)
        make_sparse(self.networks.tensors, self.generator)
        decay = self.discount * self.setting["trace"]
        self.descent = ObGD(self.networks, decay, self.setting["kappa"])
        self.keep_list("values", self.networks.tensors, learned=True)
        self.keep_list("traces", self.networks.views(self.descent.traces))
        self.pair("chosen", torch.zeros(robots, dtype=torch.int64))
        self.pair("exploratory", torch.zeros(robots, dtype=torch.bool))

    def forget_traces(self) -> None:
        super().forget_traces()
        self.descent.forget()

    def choose(self, inputs: Tensor, learning: bool) -> Tensor:
        best = self.networks(self.normal_inputs(inputs, learning)).argmax(dim=1)
        self.now["chosen"].copy_(self.epsilon_greedy(best, learning))
        self.now["exploratory"].copy_(self.now["chosen"] != best)
        return ACTIONS[self.now["chosen"]]

    def update(self, reward: Tensor) -> None:
        features, chosen = self.before["features"], self.before["chosen"][:, None]
        best = self.networks(self.now["features"]).amax(dim=1)
        value, gradient = self.networks.differentiated(
            lambda flat: self.networks(features, flat).gather(1, chosen)[:, 0]
        )
        error = self.scaled_reward(reward) + self.discount * best - value
        self.descent.step(gradient, error)
        self.descent.forget(self.before["exploratory"])


stream_q = tunable(
    discount=Setting(0.99, 0.6, 0.995, "discount of the next value", each=True),
    trace=Setting(0.8, 0.0, 0.95, "lambda: traces decay by discount times lambda", each=True),
    kappa=Setting(
        2.0, 1.0, 10.0, "factor by which steps are smaller than the bound", log=True, each=True
    ),
    epsilon=epsilon(0.01),
    epsilon_steps=epsilon_steps(7200.0),  # the published 5 % of 144,000
    hidden=hidden("as published"),
)(StreamQ)
