"""Plain online Q-learning, an agent with which the paper's robots are compared."""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor

from ....controller.networks import Networks
from ....controller.senses import Senses
from ..settings import Number, Setting, tunable
from .base import ACTIONS, OnlineLearner, epsilon, epsilon_steps


class QLearner(OnlineLearner):
    """Q-learning with one network per robot that outputs the values of 25 fixed actions.

    The update is Q(x, a) += eta [r + gamma max Q(x', .) - Q(x, a)] (Watkins, PhD thesis, Cambridge,
    1989; Watkins and Dayan, "Q-learning", Machine Learning 8, 1992, equation 1). In every step, it
    follows the gradient of a network with one hidden layer, without replay or a target network.
    Actions, discount and number of updates are those of the paper's fixed proposer. Two things
    differ: the target contains the best next action, and actions are outputs, not inputs. The
    inputs are the unscaled signals, as in the paper.
    """

    HIDDEN = 16

    def __init__(self, robots: int, senses: Senses, seed: int, **settings: Number) -> None:
        super().__init__(robots, senses, seed, settings)
        count = len(ACTIONS)
        self._networks = Networks(robots, self.inputs, self.HIDDEN, count, 0.1, self.generator)
        for name, tensor in self._networks.tensors().items():
            self.keep(name, tensor, learned=True)
        self._rows = torch.arange(robots)
        self.pair("chosen", torch.zeros(robots, dtype=torch.int64))

    def scaled(self, state: np.ndarray) -> Tensor:
        """Returns the signals unscaled, shape (B, I)."""
        return torch.from_numpy(state)

    def choose(self, inputs: Tensor, learning: bool) -> Tensor:
        values = self._networks.forward(inputs)[1]
        chosen = self.epsilon_greedy(values.argmax(dim=1), learning)
        self.now["chosen"].copy_(chosen)
        return ACTIONS[self.now["chosen"]]

    def update(self, reward: Tensor) -> None:
        inputs, chosen = self.before["inputs"], self.before["chosen"]
        best = self._networks.forward(self.now["inputs"])[1].amax(dim=1)
        hidden, values = self._networks.forward(inputs)
        error = reward + self.discount * best - values[self._rows, chosen]
        steps = torch.zeros_like(values)
        steps[self._rows, chosen] = self.setting["rate"] * error
        self._networks.ascend(inputs, hidden, steps)


q_learner = tunable(
    rate=Setting(0.05, 0.001, 0.05, "learn rate", log=True, each=True),
    discount=Setting(0.9, 0.6, 0.95, "discount of the next value; above it diverges", each=True),
    epsilon=epsilon(0.05),
    epsilon_steps=epsilon_steps(1.0),
)(QLearner)
