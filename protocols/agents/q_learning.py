"""Plain online Q-learning, as an agent to compare the paper's robots with."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import torch

from ...controller.networks import Networks, load_into
from .base import Agent


class QLearner(Agent):
    """Q-learning with one network per robot that outputs the values of 25 fixed actions.

    The update of Watkins, Q(x, a) += eta [r + gamma max Q(x', .) - Q(x, a)], follows the gradient
    of one hidden layer, one step at a time, without replay and without a target network. Actions,
    discount and number of updates are those of the paper's fixed proposer. Two things differ: the
    target contains the best next action, and actions are outputs, not inputs.
    """

    MOTORS = (-0.5, -0.25, 0.0, 0.25, 0.5)
    HIDDEN = 16
    LEARN_RATE = 0.05
    DISCOUNT = 0.9
    EPSILON = 0.05

    def __init__(self, robots: int, sensors: int, seed: int) -> None:
        """Draws the initial networks.

        Args:
          robots: Number of robots, B.
          sensors: Number of sensor signals, S.
          seed: Seed of the random stream.
        """
        self._generator = torch.Generator().manual_seed(seed)
        motors = torch.tensor(self.MOTORS)
        self._actions = torch.cartesian_prod(motors, motors)
        count = len(self._actions)
        self._networks = Networks(robots, sensors, self.HIDDEN, count, 0.1, self._generator)
        self._rows = torch.arange(robots)
        # Observation and action of the previous step, whether this step continues it, and the
        # observation and action of this step.
        self._before = torch.zeros(robots, sensors)
        self._chosen_before = torch.zeros(robots, dtype=torch.int64)
        self._chained = torch.zeros(1)
        self._now = torch.zeros(robots, sensors)
        self._chosen = torch.zeros(robots, dtype=torch.int64)
        self._fresh = torch.ones(1)

    def reset(self) -> None:
        """See `Agent.reset`."""
        self._fresh.fill_(1)

    @torch.inference_mode()
    def act(self, state: np.ndarray, learning: bool) -> np.ndarray:
        """See `Agent.act`."""
        self._before.copy_(self._now)
        self._chosen_before.copy_(self._chosen)
        self._chained.copy_(1 - self._fresh)
        self._fresh.zero_()
        self._now.copy_(torch.from_numpy(state))
        self._chosen.copy_(self._networks.forward(self._now)[1].argmax(dim=1))
        if learning:
            size = self._chosen.shape
            uniform = torch.randint(len(self._actions), size, generator=self._generator)
            exploratory = torch.rand(size, generator=self._generator) < self.EPSILON
            self._chosen.copy_(torch.where(exploratory, uniform, self._chosen))
        return self._actions[self._chosen].numpy()

    @torch.inference_mode()
    def learn(self, reward: np.ndarray) -> None:
        """See `Agent.learn`."""
        best = self._networks.forward(self._now)[1].amax(dim=1)
        hidden, values = self._networks.forward(self._before)
        value = values[self._rows, self._chosen_before]
        error = torch.from_numpy(reward) + self.DISCOUNT * best - value
        steps = torch.zeros_like(values)
        steps[self._rows, self._chosen_before] = self.LEARN_RATE * self._chained * error
        self._networks.ascend(self._before, hidden, steps)

    def state(self) -> dict[str, np.ndarray]:
        """See `Agent.state`."""
        return {name: tensor.numpy() for name, tensor in self._tensors().items()}

    def load_state(self, arrays: Mapping[str, np.ndarray]) -> None:
        """See `Agent.load_state`."""
        tensors = self._tensors()
        load_into(tensors, {name: torch.from_numpy(array) for name, array in arrays.items()})
        self._generator.set_state(tensors["generator"])

    def weights(self) -> dict[str, np.ndarray]:
        """See `Agent.weights`."""
        return {name: tensor.numpy() for name, tensor in self._networks.tensors().items()}

    def _tensors(self) -> dict[str, torch.Tensor]:
        return self._networks.tensors() | {
            "before": self._before,
            "chosen_before": self._chosen_before,
            "chained": self._chained,
            "now": self._now,
            "chosen": self._chosen,
            "fresh": self._fresh,
            "generator": self._generator.get_state(),
        }


def q_learner(robots: int, sensors: int, seed: int) -> Agent:
    """Makes one Q-learner for each robot; see `QLearner`."""
    return QLearner(robots, sensors, seed)
