"""The modular neurocontroller: evaluation network, creative memory, proposer (section 2)."""

from __future__ import annotations

import torch
from torch import Tensor

from .evaluation import EvaluationNetwork
from .exploration import make_exploration
from .memory import CreativeMemory
from .networks import load_into
from .parameters import Parameters
from .proposers import make_proposer
from .reading import Reading, Senses


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
        self,
        parameters: Parameters,
        proposer: str,
        robots: int,
        sensors: int,
        seed: int,
        senses: Senses | None = None,
    ) -> None:
        """Draws B newborn brains.

        Args:
          parameters: every number.
          proposer: "fixed", "random" or "creative".
          robots: B.
          sensors: S, numbers in a state.
          seed: of the brains' one random stream.
          senses: what the numbers in a state, and the reward, are; brains that read them as
            they are, as the paper's do, need not be told.

        Raises:
          ValueError: there is no such proposer, or the brains must be told of their senses.
        """
        self._parameters = parameters
        self._generator = torch.Generator().manual_seed(seed)
        self._reading = Reading(parameters, sensors, senses)
        inputs = self._reading.inputs
        self.evaluation = EvaluationNetwork(parameters, robots, inputs, self._generator)
        self.memory = (
            CreativeMemory(parameters, robots, inputs, self._generator)
            if proposer == "creative"
            else None
        )
        self._proposer = make_proposer(proposer, parameters, self.memory, self._generator)
        self._exploration = make_exploration(parameters, robots, self._generator)
        self._rows = torch.arange(robots)
        self._age = torch.tensor(0)  # steps of learning
        # Those with a full load in a row, and all that come after once a robot is content.
        self._full_steps = torch.zeros(robots, dtype=torch.int64)
        # What was sensed, done and expected, now and a step ago. A robot whose `chained` is 0
        # has no step ago: it was born or placed anew, and has nothing to learn from yet.
        self._now = self._blank(robots, inputs)
        self._before = self._blank(robots, inputs)

    def _blank(self, robots: int, inputs: int) -> dict[str, Tensor]:
        blank = {
            "state": torch.zeros(robots, inputs),
            "action": torch.zeros(robots, 2),
            "value": torch.zeros(robots),
            "chained": torch.zeros(robots),
        }
        if self._parameters.remembers_best:
            blank |= {"best_action": torch.zeros(robots, 2), "best_value": torch.zeros(robots)}
        if self._parameters.remembers_reward:  # 0 where it is not known: it was not learnt from
            blank |= {"reward": torch.zeros(robots), "rewarded": torch.zeros(robots)}
        return blank

    def propose(self, state: Tensor) -> Tensor:
        """The actions to choose from, shape (B, A, 2), in a state (B, S); other ones every time."""
        return self._proposer.propose(self._reading.state(state))

    def values(self, state: Tensor, actions: Tensor) -> Tensor:
        """What it thinks of actions, shape (B, A), for (B, A, 2), in a state (B, S)."""
        return self._judged(self._reading.state(state), actions)

    def _judged(self, inputs: Tensor, actions: Tensor) -> Tensor:
        return self.evaluation.values(inputs, self._reading.motors(actions))

    def act(self, state: Tensor, explore: bool) -> Tensor:
        """Chooses each robot's best proposed action, or with epsilon any of them.

        Args:
          state: sensor signals, shape (B, S).
          explore: whether epsilon-greedy as in training, or as in the tests: greedy, unless
            there is a `test_epsilon`.

        Returns:
          Motor values in [-0.5, 0.5], shape (B, 2).
        """
        inputs = self._reading.state(state)
        actions = self._proposer.propose(inputs)
        ideas = actions.shape[1]
        epsilon = self._parameters.test_epsilon
        if explore:
            epsilon = self._parameters.epsilon_at(int(self._age))
        astray = None
        if explore or epsilon:
            actions, astray = self._exploration.stray(actions, epsilon)
            if self._parameters.content_steps:
                astray = torch.where(self._content(), -1, astray)
        values = self._judged(inputs, actions)
        best = chosen = values[:, :ideas].argmax(dim=1)
        if astray is not None:
            chosen = torch.where(astray < 0, best, astray)
        self._before, self._now = self._now, self._before
        now, rows = self._now, self._rows
        now["state"].copy_(inputs)
        now["action"].copy_(actions[rows, chosen])
        now["value"].copy_(values[rows, chosen])
        now["chained"].fill_(1)
        if self._parameters.remembers_best:
            now["best_action"].copy_(actions[rows, best])
            now["best_value"].copy_(values[rows, best])
        if self._parameters.remembers_reward:
            now["reward"].zero_()
            now["rewarded"].zero_()
        return now["action"].clone()

    def learn(self, reward: Tensor) -> Tensor:
        """Learns from the step that led to what `act` was last told.

        Args:
          reward: sensed along with the state last given to `act`, shape (B,).

        Returns:
          The TD error, shape (B,); 0 for a robot without a step to learn from.
        """
        before, rate = self._before, self._parameters.learn_rate_at(int(self._age))
        gain, ahead, learning = self._outcome(self._reading.reward(reward))
        if self._parameters.content_steps:
            goes_on = self._reading.is_full(reward) | self._content()
            self._full_steps.copy_(torch.where(goes_on, self._full_steps + 1, 0))
            learning = learning * ~self._content()
        action = self._reading.motors(before["action"])
        error = self.evaluation.learn(before["state"], action, gain, ahead, learning, rate)
        if self.memory is not None and self._parameters.memory_goal == "selected":
            self.memory.learn(before["state"], before["action"], error)
        elif self.memory is not None:
            self.memory.learn(before["state"], before["best_action"], learning, rate)
        self._age += 1
        return error

    def _content(self) -> Tensor:
        """Who has had a full load for so long that it learns and explores no more, shape (B,)."""
        return self._full_steps >= self._parameters.content_steps

    def _outcome(self, reward: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """What is learnt from a step: r and V' of Eq. 1, and who learns, each of shape (B,)."""
        parameters, now, before = self._parameters, self._now, self._before
        ahead = now["best_value" if parameters.next_value == "best" else "value"]
        learning = before["chained"]
        if parameters.remembers_reward:
            if parameters.lingering:
                left = parameters.lingering * before["reward"] * before["chained"]
                reward = torch.where(reward < 0, reward, torch.maximum(reward, left))
            now["reward"].copy_(reward)
            now["rewarded"].fill_(1)
            learning = learning * before["rewarded"]
            change = reward - before["reward"]
            if parameters.next_value_capped:
                lost = (change < 0) & (reward <= 0)
                had = before["reward"].clamp(min=0)
                ahead = torch.where(lost, torch.minimum(ahead, had), ahead)
            if parameters.reward == "change":
                reward = change
        if parameters.action_gap:
            worse = (before["best_value"] - before["value"]).clamp(min=0)
            reward = reward - parameters.action_gap * worse
        return reward, ahead, learning

    def forget_step(self, robots: Tensor | None = None) -> None:
        """Breaks the chain of steps, as when robots (indices; None: all) are placed anew."""
        self._now["chained"][slice(None) if robots is None else robots] = 0

    def networks(self) -> dict[str, Tensor]:
        """All weights and biases, "evaluation.*" and so on, each of shape (B, ...)."""
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
        parts = {
            "now": self._now,
            "evaluation.optimizer": self.evaluation.optimizer.tensors(),
            "exploration": self._exploration.tensors(),
        }
        if self._parameters.ages:
            parts["learning"] = {"age": self._age}
        if self._parameters.content_steps:
            parts["contentment"] = {"full_steps": self._full_steps}
        if self.memory is not None:
            parts["noise"] = self.memory.patterns.tensors()
            parts["memory.optimizer"] = self.memory.optimizer.tensors()
        return state | {
            f"{part}.{name}": tensor
            for part, tensors in parts.items()
            for name, tensor in tensors.items()
        }

    def load_state(self, tensors: dict[str, Tensor]) -> None:
        """Goes on from a `state`, to the bit.

        Raises:
          ValueError: a tensor is missing, or its shape is another.
        """
        state = self.state()
        generator = state.pop("generator").clone()
        load_into(state | {"generator": generator}, tensors)
        self._generator.set_state(generator)
