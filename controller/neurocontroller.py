"""The modular neurocontroller: evaluation network, creative memory, proposer (section 2)."""

from __future__ import annotations

import torch
from torch import Tensor

from .evaluation import EvaluationNetwork
from .memory import CreativeMemory
from .networks import load_into
from .parameters import Parameters
from .proposers import make_proposer


class Neurocontroller:
    """The brains of B robots; a single robot is a batch of one.

    At every control step call `act` with what the robots sense, then, where they learn,
    `learn` with the reward that came along with it:

        motors = brain.act(state, explore=learning)
        if learning:
            brain.learn(reward)

    Attributes:
      evaluation: judges actions.
      memory: proposes them; None for proposers that need none.
    """

    def __init__(
        self, parameters: Parameters, proposer: str, robots: int, sensors: int, seed: int
    ) -> None:
        """Draws B newborn brains.

        Args:
          parameters: every number.
          proposer: "fixed", "random" or "creative".
          robots: B.
          sensors: S, numbers in a state.
          seed: of the brains' one random stream.

        Raises:
          ValueError: there is no such proposer.
        """
        self._parameters = parameters
        self._generator = torch.Generator().manual_seed(seed)
        self.evaluation = EvaluationNetwork(parameters, robots, sensors, self._generator)
        self.memory = (
            CreativeMemory(parameters, robots, sensors, self._generator)
            if proposer == "creative"
            else None
        )
        self._proposer = make_proposer(proposer, parameters, self.memory, self._generator)
        self._rows = torch.arange(robots)
        # What was sensed, done and expected, now and a step ago. A robot whose `chained` is 0
        # has no step ago: it was born or placed anew, and has nothing to learn from yet.
        self._now = self._blank(robots, sensors)
        self._before = self._blank(robots, sensors)

    @staticmethod
    def _blank(robots: int, sensors: int) -> dict[str, Tensor]:
        return {
            "state": torch.zeros(robots, sensors),
            "action": torch.zeros(robots, 2),
            "value": torch.zeros(robots),
            "chained": torch.zeros(robots),
        }

    def propose(self, state: Tensor) -> Tensor:
        """The actions to choose from, shape (B, A, 2), in a state (B, S); other ones every time."""
        return self._proposer.propose(state)

    def act(self, state: Tensor, explore: bool) -> Tensor:
        """Chooses each robot's best proposed action, or with epsilon any of them.

        Args:
          state: sensor signals, shape (B, S).
          explore: whether epsilon-greedy as in training, or as in the tests: greedy, unless
            there is a `test_epsilon`.

        Returns:
          Motor values in [-0.5, 0.5], shape (B, 2).
        """
        actions = self.propose(state)
        values = self.evaluation.values(state, actions)
        chosen = values.argmax(dim=1)
        epsilon = self._parameters.epsilon if explore else self._parameters.test_epsilon
        if epsilon or explore:
            size = chosen.shape
            anything = torch.randint(actions.shape[1], size, generator=self._generator)
            strays = torch.rand(size, generator=self._generator) < epsilon
            chosen = torch.where(strays, anything, chosen)
        self._before, self._now = self._now, self._before
        self._now["state"].copy_(state)
        self._now["action"].copy_(actions[self._rows, chosen])
        self._now["value"].copy_(values[self._rows, chosen])
        self._now["chained"].fill_(1)
        return self._now["action"].clone()

    def learn(self, reward: Tensor) -> Tensor:
        """Learns from the step that led to what `act` was last told.

        Args:
          reward: sensed along with the state last given to `act`, shape (B,).

        Returns:
          The TD error, shape (B,); 0 for a robot without a step to learn from.
        """
        before = self._before
        error = self.evaluation.learn(
            before["state"], before["action"], reward, self._now["value"], before["chained"]
        )
        if self.memory is not None:
            self.memory.learn(before["state"], before["action"], error)
        return error

    def forget_step(self, robots: Tensor | None = None) -> None:
        """Breaks the chain of steps, as when robots (indices; None: all) are placed anew."""
        self._now["chained"][slice(None) if robots is None else robots] = 0

    def networks(self) -> dict[str, Tensor]:
        """All weights and biases, "evaluation.*" and "memory.*", each of shape (B, ...)."""
        owners = {"evaluation": self.evaluation.networks}
        if self.memory is not None:
            owners["memory"] = self.memory.networks
        return {
            f"{owner}.{name}": tensor
            for owner, networks in owners.items()
            for name, tensor in networks.tensors().items()
        }

    def load_networks(self, tensors: dict[str, Tensor]) -> None:
        """Puts other brains, as `networks` gave them, into the robots.

        Raises:
          ValueError: a tensor is missing, or its shape is another.
        """
        load_into(self.networks(), tensors)

    def state(self) -> dict[str, Tensor]:
        """Everything that the next steps depend on, for a checkpoint between two steps.

        These are the tensors themselves: clone what is to outlive the next step.
        """
        state = self.networks() | {"generator": self._generator.get_state()}
        state |= {f"now.{name}": tensor for name, tensor in self._now.items()}
        if self.memory is not None:
            state |= {f"noise.{k}": tensor for k, tensor in self.memory.patterns.tensors().items()}
        return state

    def load_state(self, tensors: dict[str, Tensor]) -> None:
        """Goes on from a `state`, to the bit.

        Raises:
          ValueError: a tensor is missing, or its shape is another.
        """
        state = self.state()
        generator = state.pop("generator").clone()
        load_into(state | {"generator": generator}, tensors)
        self._generator.set_state(generator)
