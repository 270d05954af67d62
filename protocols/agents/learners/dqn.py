"""DQN: Q-learning with a replay memory, in a life without episodes."""

from __future__ import annotations

import torch
import torch.nn.functional as F
from torch import Tensor

from ....controller.senses import Senses
from ..settings import Number, Setting, tunable
from .base import ACTIONS, OnlineLearner, epsilon, epsilon_steps, hidden
from .networks import LayeredNetworks, column

Transitions = tuple[Tensor, Tensor, Tensor, Tensor]
"""N steps of B robots: inputs (B, N, I), actions (B, N), next inputs (B, N, I), rewards (B, N)."""


class DQNWithoutReplay(OnlineLearner):
    """DQN without its memory: a robot learns from each transition once, when it happens.

    It has the Huber loss, Adam, and a target network, a copy made every `COPY` steps.
    """

    COPY = 500

    def __init__(self, robots: int, senses: Senses, seed: int, **settings: Number) -> None:
        super().__init__(robots, senses, seed, settings)
        width, outputs = int(self.setting["hidden"]), len(ACTIONS)
        sizes = (self.inputs, width, width, outputs)
        self.networks = LayeredNetworks(robots, sizes, self.generator, F.relu)
        self._adam = self.trained("values", self.networks, self.setting["rate"])
        self._target = self.networks.flat.clone()
        self.keep_list("target", self.networks.views(self._target))
        self.pair("chosen", torch.zeros(robots, dtype=torch.int64))
        self._count = self.keep("count", torch.zeros(1, dtype=torch.int64))

    def choose(self, inputs: Tensor, learning: bool) -> Tensor:
        best = self.networks(inputs).argmax(dim=1)
        self.now["chosen"].copy_(self.epsilon_greedy(best, learning))
        return ACTIONS[self.now["chosen"]]

    def update(self, reward: Tensor) -> None:
        inputs, acted, following, rewards = self.transitions(reward)
        best = self.networks(following, self._target).amax(dim=2)
        target = rewards + column(self.discount) * best
        layers = self.networks.layers(inputs)
        error = layers[-1].gather(2, acted[..., None])[..., 0] - target
        # Derivative of the Huber loss, averaged over the transitions.
        slopes = torch.zeros_like(layers[-1])
        slopes.scatter_(2, acted[..., None], (error.clamp(-1, 1) / error.shape[1])[..., None])
        self._adam.step(self.networks.relu_gradient(layers, slopes))
        self._count += 1
        if int(self._count) % self.COPY == 0:
            self._target.copy_(self.networks.flat)

    def transitions(self, reward: Tensor) -> Transitions:
        """Returns the transitions to learn from; `reward`, (B,), is that of the last one."""
        before, now = self.before, self.now
        last = before["inputs"], before["chosen"], now["inputs"], reward
        inputs, acted, following, rewards = (tensor[:, None] for tensor in last)
        return inputs, acted, following, rewards


class DQN(DQNWithoutReplay):
    """DQN (Mnih et al., "Human-level control through deep reinforcement learning", Nature 2015).

    Algorithm 1 of the source, in a life without episodes. A robot keeps its last `REPLAY`
    transitions and learns from `BATCH` of them in each step, drawn uniformly. All other learners
    see each transition once. The source trains for 50 million frames of a game, with a memory of a
    million transitions, an update every fourth action after the first 50,000, a copy every 10,000
    updates, and RMSProp instead of Adam.
    """

    REPLAY, BATCH = 50_000, 32

    def __init__(self, robots: int, senses: Senses, seed: int, **settings: Number) -> None:
        super().__init__(robots, senses, seed, **settings)
        # Inputs, next inputs and reward of each transition, and its action.
        columns = 2 * self.inputs + 1
        self._replay = self.keep("replay", torch.zeros(robots, self.REPLAY, columns))
        self._acted = self.keep("acted", torch.zeros(robots, self.REPLAY, dtype=torch.uint8))

    def transitions(self, reward: Tensor) -> Transitions:
        count = int(self._count)
        place = count % self.REPLAY
        self._replay[:, place] = torch.cat(
            [self.before["inputs"], self.now["inputs"], reward[:, None]], dim=1
        )
        self._acted[:, place] = self.before["chosen"]
        size = self.robots, self.BATCH
        drawn = torch.randint(min(count + 1, self.REPLAY), size, generator=self.generator)
        rows = torch.arange(self.robots)[:, None]
        inputs, following, rewards = self._replay[rows, drawn].split(
            [self.inputs, self.inputs, 1], dim=2
        )
        return inputs, self._acted[rows, drawn].long(), following, rewards[..., 0]


SETTINGS = {
    "rate": Setting(0.001, 1e-4, 1e-2, "learn rate", log=True, each=True),
    "discount": Setting(0.95, 0.6, 0.99, "discount of the next value", each=True),
    "epsilon": epsilon(0.05),
    "epsilon_steps": epsilon_steps(7200.0),
    "hidden": hidden(),
}

dqn = tunable(**SETTINGS)(DQN)
dqn_no_replay = tunable(**SETTINGS)(DQNWithoutReplay)
