"""What all online learners share: transitions, scaled inputs, checkpoints."""

from __future__ import annotations

import abc
from collections.abc import Iterable, Mapping

import numpy as np
import torch
from torch import Tensor

from ....controller.networks import load_into
from ....controller.senses import Senses
from ..base import Agent
from ..settings import Number, Setting
from .networks import Adam, LayeredNetworks

LARGEST = 0.5  # motor value
# The paper's 25 fixed actions, motor values of shape (25, 2).
ACTIONS = torch.cartesian_prod(*[torch.linspace(-LARGEST, LARGEST, 5)] * 2)


def epsilon(default: float) -> Setting:
    """Returns the setting `epsilon`: final probability of a random action."""
    says = "probability of a random action after `epsilon_steps`"
    return Setting(default, 0.01, 0.2, says, log=True, each=True)


def hidden(published: str = "") -> Setting:
    """Returns the setting `hidden`, neurons of a hidden layer; `published` notes the source's."""
    says = f"neurons of each of two hidden layers{published and '; '}{published}"
    return Setting(32, 4, 256, says, tuned=False)


def epsilon_steps(default: float) -> Setting:
    """Returns the setting `epsilon_steps`: training steps in which epsilon falls from 1."""
    says = "training steps in which epsilon falls from 1; with 1 it is constant"
    return Setting(default, 1.0, 72_000.0, says, log=True, each=True)


class OnlineLearner(Agent):
    """B learners that learn in every step of training, in one life without episodes.

    In each step, `Agent.act` is called before `Agent.learn`. So the weights that choose an action
    have not yet learned from the transition to the current state, as in the paper's robot.

    A subclass registers each tensor that its next steps depend on with `keep`, or with `pair` if it
    needs the tensor of the previous step, too. Checkpoints contain all registered tensors.

    Example:
      What SARSA with a network would register in its `__init__`:

        self.networks = LayeredNetworks(robots, [self.inputs, 32, len(ACTIONS)], self.generator)
        self.adam = self.trained("networks", self.networks, self.setting["rate"])
        self.pair("chosen", torch.zeros(robots, dtype=torch.int64))  # indices in `ACTIONS`

      `choose` sets `self.now["chosen"]`; `update` finds the last one in `self.before["chosen"]`.

    Attributes:
      robots: Number of robots, B.
      inputs: Number I of inputs of a network, one for each signal.
      generator: Random stream of all exploration and initial weights, shared by the robots.
      setting: Each setting by name: a number, or, where robots differ, a tensor of shape (B,).
      discount: Discount factor for each control step, a number or a tensor of shape (B,).
      now: Tensors of this step by name: "inputs", shape (B, I), and those that `pair` registered.
      before: The same tensors of the previous step.
    """

    def __init__(
        self, robots: int, senses: Senses, seed: int, settings: Mapping[str, Number]
    ) -> None:
        """Prepares B learners with one random stream, seeded by `seed`.

        With the settings `epsilon` and `epsilon_steps`, learners explore by random actions.
        """
        self.robots, self.inputs = robots, len(senses.state)
        self.generator = torch.Generator().manual_seed(seed)
        low, high = torch.tensor([(signal.low, signal.high) for signal in senses.state]).T
        self._middle, self._half = (low + high) / 2, (high - low) / 2
        self.now: dict[str, Tensor] = {}
        self.before: dict[str, Tensor] = {}
        self._kept: dict[str, Tensor] = {}
        self._learned: dict[str, Tensor] = {}
        # Whether the previous step led to this one; whether the robots are placed before the next.
        self._chained = self.keep("chained", torch.zeros(1, dtype=torch.bool))
        self._placed = self.keep("placed", torch.ones(1, dtype=torch.bool))
        self.pair("inputs", torch.zeros(robots, self.inputs))
        self.setting: dict[str, float | Tensor] = {
            name: torch.from_numpy(value).float() if isinstance(value, np.ndarray) else value
            for name, value in settings.items()
        }
        self.discount = self.setting["discount"]
        if "epsilon" in settings:
            self._age = self.keep("age", torch.zeros(1))

    def keep(self, name: str, tensor: Tensor, learned: bool = False) -> Tensor:
        """Registers a tensor that changes in place, by its name in checkpoints, and returns it.

        `learned`: whether actions in a test depend on it; `weights` then returns it, (B, ...).
        """
        self._kept[name] = tensor
        if learned:
            self._learned[name] = tensor
        return tensor

    def keep_list(self, name: str, tensors: Iterable[Tensor], learned: bool = False) -> None:
        """Registers several tensors; see `keep`."""
        for number, tensor in enumerate(tensors):
            self.keep(f"{name}.{number}", tensor, learned)

    def pair(self, name: str, tensor: Tensor) -> None:
        """Registers a tensor of each step: `now` has this step's, `before` the previous step's."""
        self.now[name] = self.keep(f"now.{name}", tensor)
        self.before[name] = self.keep(f"before.{name}", tensor.clone())

    def scaled(self, state: np.ndarray) -> Tensor:
        """Returns the inputs: signals scaled to [-1, 1], shape (B, I)."""
        return (torch.from_numpy(state) - self._middle) / self._half

    def trained(
        self, name: str, networks: LayeredNetworks, rate: float | Tensor, mean_decay: float = 0.9
    ) -> Adam:
        """Registers networks and the state of their Adam optimiser; returns the optimiser."""
        adam = Adam(networks, rate, mean_decay)
        self.keep_list(name, networks.tensors, learned=True)
        steps, *moments = adam.tensors
        kept = [part for moment in moments for part in networks.views(moment)]
        self.keep_list(f"{name}.adam", [steps, *kept])
        return adam

    @abc.abstractmethod
    def choose(self, inputs: Tensor, learning: bool) -> Tensor:
        """Chooses motor values, shape (B, 2), and stores in `now` what `update` will need.

        Args:
          inputs: Scaled signals, shape (B, I).
          learning: Whether the robots are in training; in tests, the learner must not explore.
        """

    @abc.abstractmethod
    def update(self, reward: Tensor) -> None:
        """Learns from the transition from `before` to `now`, with its reward, shape (B,)."""

    def forget_traces(self) -> None:
        """Forgets the traces of earlier steps: when robots are placed anew, and in tests."""

    def reset(self) -> None:
        self._placed.fill_(True)
        self.forget_traces()

    @torch.no_grad()
    def act(self, state: np.ndarray, learning: bool) -> np.ndarray:
        for name, tensor in self.now.items():
            self.before[name].copy_(tensor)
        self._chained.copy_(~self._placed)
        self._placed.fill_(False)
        if not learning:
            self.forget_traces()  # they must not bridge a test
        self.now["inputs"].copy_(self.scaled(state))
        return self.choose(self.now["inputs"], learning).numpy()

    @torch.no_grad()
    def learn(self, reward: np.ndarray) -> None:
        if self._chained:
            self.update(torch.from_numpy(reward))

    def state(self) -> dict[str, np.ndarray]:
        return {name: tensor.contiguous().numpy() for name, tensor in self._tensors().items()}

    def load_state(self, arrays: Mapping[str, np.ndarray]) -> None:
        tensors = self._tensors()
        load_into(tensors, {name: torch.from_numpy(array) for name, array in arrays.items()})
        self.generator.set_state(tensors["generator"])

    def weights(self) -> dict[str, np.ndarray]:
        return {name: tensor.contiguous().numpy() for name, tensor in self._learned.items()}

    def load_weights(self, arrays: Mapping[str, np.ndarray]) -> None:
        load_into(self._learned, {name: torch.from_numpy(a) for name, a in arrays.items()})

    def draw_exploratory(self) -> Tensor:
        """Returns which robots take a random action, (B,); called once in each training step.

        The probability falls linearly from 1 to `epsilon` in `epsilon_steps`.
        """
        self._age += 1
        epsilon, steps = self.setting["epsilon"], self.setting["epsilon_steps"]
        left = 1 - float(self._age) / steps
        left = left.clamp(min=0) if isinstance(left, Tensor) else max(left, 0.0)
        probability = epsilon + (1 - epsilon) * left
        return torch.rand(self.robots, generator=self.generator) < probability

    def epsilon_greedy(self, best: Tensor, learning: bool) -> Tensor:
        """Returns each robot's index in `ACTIONS`, (B,): `best`, or a random one to explore."""
        if not learning:
            return best
        uniform = torch.randint(len(ACTIONS), best.shape, generator=self.generator)
        return torch.where(self.draw_exploratory(), uniform, best)

    def _tensors(self) -> dict[str, Tensor]:
        return self._kept | {"generator": self.generator.get_state()}
