"""DQN: Q-learning with a replay memory, in a life without episodes."""

from __future__ import annotations

import torch
import torch.nn.functional as F
from torch import Tensor

from ....controller.senses import Senses
from ..base import Agent
from ..settings import Number, Setting, tunable
from .base import ACTIONS, OnlineLearner, epsilon, epsilon_steps, hidden
from .networks import LayeredNetworks, column


class DQN(OnlineLearner):
    """DQN (Mnih et al., "Human-level control through deep reinforcement learning", Nature 2015).

    Algorithm 1 of the source, in a life without episodes. A robot keeps its last `REPLAY`
    transitions and learns from `BATCH` of them in each step, drawn uniformly, with the Huber loss
    and a target network that is copied every `COPY` steps. It shows how much replay helps in a
    life; all other learners see each transition once. The source, for 50 million frames of a game,
    has a memory of a million transitions, an update every fourth action after the first 50,000, a
    copy every 10,000 updates, and RMSProp instead of Adam.
    """

    REPLAY, BATCH, COPY = 50_000, 32, 500

    def __init__(self, robots: int, senses: Senses, seed: int, **settings: Number) -> None:
        super().__init__(robots, senses, seed, settings)
        width, outputs = int(self.setting["hidden"]), len(ACTIONS)
        sizes = (self.inputs, width, width, outputs)
        self.networks = LayeredNetworks(robots, sizes, self.generator, F.relu)
        self._adam = self.trained("values", self.networks, self.setting["rate"])
        self._target = self.keep("target", self.networks.flat.clone())
        self.pair("chosen", torch.zeros(robots, dtype=torch.int64))
        # Inputs, next inputs and reward of each transition, and its action.
        columns = 2 * self.inputs + 1
        self._replay = self.keep("replay", torch.zeros(robots, self.REPLAY, columns))
        self._acted = self.keep("acted", torch.zeros(robots, self.REPLAY, dtype=torch.uint8))
        self._count = self.keep("count", torch.zeros(1, dtype=torch.int64))

    def choose(self, inputs: Tensor, learning: bool) -> Tensor:
        best = self.networks(inputs).argmax(dim=1)
        self.now["chosen"].copy_(self.epsilon_greedy(best, learning))
        return ACTIONS[self.now["chosen"]]

    def update(self, reward: Tensor) -> None:
        count = int(self._count)
        place = count % self.REPLAY
        self._replay[:, place] = torch.cat(
            [self.before["inputs"], self.now["inputs"], reward[:, None]], dim=1
        )
        self._acted[:, place] = self.before["chosen"]
        self._count += 1
        size = self.robots, self.BATCH
        drawn = torch.randint(min(count + 1, self.REPLAY), size, generator=self.generator)
        rows = torch.arange(self.robots)[:, None]
        inputs, following, rewards = self._replay[rows, drawn].split(
            [self.inputs, self.inputs, 1], dim=2
        )
        acted = self._acted[rows, drawn][..., None].long()
        best = self.networks(following, self._target).amax(dim=2)
        target = rewards[..., 0] + column(self.discount) * best

        def loss(flat: Tensor) -> Tensor:
            values = self.networks(inputs, flat).gather(2, acted)[..., 0]
            return F.smooth_l1_loss(values, target, reduction="none").mean(dim=1)

        self._adam.descend(loss)
        if (count + 1) % self.COPY == 0:
            self._target.copy_(self.networks.flat)


class DQNWithoutReplay(DQN):
    """DQN that learns from each transition once: its memory holds only the last transition."""

    REPLAY, BATCH = 1, 1


SETTINGS = {
    "rate": Setting(0.001, 1e-4, 1e-2, "learn rate", log=True, each=True),
    "discount": Setting(0.95, 0.6, 0.99, "discount of the next value", each=True),
    "epsilon": epsilon(0.05),
    "epsilon_steps": epsilon_steps(7200.0),
    "hidden": hidden(),
}


@tunable(**SETTINGS)
def dqn(robots: int, senses: Senses, seed: int, **settings: Number) -> Agent:
    """DQN: Q-learning from a memory of the last 50,000 transitions (Mnih et al. 2015)."""
    return DQN(robots, senses, seed, **settings)


@tunable(**SETTINGS)
def dqn_no_replay(robots: int, senses: Senses, seed: int, **settings: Number) -> Agent:
    """`dqn` without its memory: it learns from the last transition only."""
    return DQNWithoutReplay(robots, senses, seed, **settings)
