"""The modular neurocontroller: evaluation network, creative memory, action proposer (section 2)."""

from __future__ import annotations

import itertools
from collections.abc import Mapping

import torch
from torch import Tensor

from .context import EchoContext
from .creative_memory import CreativeMemory
from .evaluation_network import EvaluationNetwork, td_target
from .exploration import EpsilonGreedy, Exploration, PersistentExploration, Schedule
from .networks import load_into
from .parameters import PROPOSERS, Parameters
from .senses import Encoding, Senses, unsaturated
from .step import Step


class Neurocontroller:
    """The brains of B robots; a single robot is a batch of one.

    All tensors, arguments and results included, are on the device that was PyTorch's default when
    the brains were made, for example within `with torch.device("cuda:0")`. A step copies nothing
    between that device and the host.

    In every control step, call `act` with the sensed state and then, during training, `learn`
    with the reward sensed in the same step:

        motors = brain.act(state, explore=training)
        if training:
            brain.learn(reward)

    Attributes:
      evaluation: Evaluation network, which computes the values of actions.
      memory: Creative memory, which proposes actions; None unless the proposer is "creative".
      generator: Random stream of all draws.
      epsilon: Probability that a robot begins to explore in training, a `Schedule`.
      learn_rate: Learn rate of the evaluation network, a `Schedule`.
    """

    def __init__(
        self,
        parameters: Parameters,
        proposer: str,
        robots: int,
        senses: Senses,
        seed: int,
    ) -> None:
        """Draws the initial brains.

        Args:
          parameters: Parameters that all B brains share.
          proposer: Action proposer, "fixed", "random" or "creative".
          robots: Number B of robots.
          senses: Ranges of the S sensor signals in a state, and of the reward.
          seed: Seed of the brains' random stream.

        Raises:
          ValueError: The proposer is unknown.
        """
        if proposer not in PROPOSERS:
            raise ValueError(f"proposer must be one of {', '.join(PROPOSERS)}, got {proposer!r}")
        p = self._parameters = parameters
        generator = torch.Generator(torch.get_default_device()).manual_seed(seed)
        self.generator = generator

        self._encoding = Encoding(senses.state, p.centred_inputs, p.raw_signals)
        self._maximal_reward = None
        if p.raw_reward and senses.reward.maximal:
            self._maximal_reward = torch.tensor(senses.reward.maximal)
        self._context = None
        if p.context_neurons:
            self._context = EchoContext(robots, self._encoding.inputs, p.context_neurons, generator)

        inputs = self._encoding.inputs + p.context_neurons
        self.evaluation = EvaluationNetwork(p, robots, inputs, generator)
        self.memory = self._fixed = None
        self._random = p.ideas if proposer == "random" else 0
        if proposer == "creative":
            self.memory = CreativeMemory(p, robots, inputs, generator)
            self._random = p.random_ideas
        if proposer == "fixed":
            pairs = [*itertools.product(p.fixed_motors, repeat=2)]
            self._fixed = torch.tensor(pairs, dtype=torch.get_default_dtype())
        self._exploration: Exploration = EpsilonGreedy(generator)
        if p.exploration_steps:
            self._exploration = PersistentExploration(robots, p.exploration_steps, generator)
        self.epsilon = Schedule(p.epsilon, p.initial_epsilon, p.epsilon_decay_steps)
        self.learn_rate = Schedule(p.learn_rate, p.initial_learn_rate, p.learn_rate_decay_steps)

        self._age = 0  # steps of training
        self._swapped = False
        detailed = p.needs_best or p.compares_rewards
        self._previous, self._current = (Step(robots, inputs, detailed) for _ in range(2))

    def act(self, state: Tensor, explore: bool) -> Tensor:
        """Selects each robot's action, epsilon-greedily (section 2).

        Args:
          state: Sensor signals, shape (B, S).
          explore: Whether the probability of exploratory actions is `epsilon`, as in training; if
            False, it is `test_epsilon`.

        Returns:
          Motor values in [-0.5, 0.5], shape (B, 2).
        """
        self.begin()
        return self.select(state, explore)

    def learn(self, reward: Tensor) -> Tensor:
        """Learns from the previous step and from the reward for its action (Eq. 1, section 3).

        Args:
          reward: Reward for the previous action, sensed in the present step, shape (B,).

        Returns:
          The TD error, shape (B,); 0 for a robot without a previous step.
        """
        error = self.update(reward)
        self.end()
        return error

    # `select` and `update` do the work of `act` and `learn` on the device; on a GPU, they are
    # captured and replayed (see `protocols.runs.device`). `begin` and `end` do the host's part.

    def begin(self) -> bool:
        """Begins a control step: the present step becomes the previous one.

        Redraws noise patterns that are due, and sets epsilon and learn rate for the robots' age.

        Returns:
          A flag that changes in each step, and tells which of the two remembered steps is the
          present one.
        """
        if self.memory is not None:
            self.memory.patterns.renew()
        self.epsilon.update(self._age)
        self.learn_rate.update(self._age)
        self._previous, self._current = self._current, self._previous
        self._swapped = not self._swapped
        return self._swapped

    def select(self, state: Tensor, explore: bool) -> Tensor:
        """Selects each robot's action, as `act` does; call `begin` before."""
        inputs = self._inputs(state)
        ideas = actions = self._propose(inputs)
        exploratory = None
        if explore or self._parameters.test_epsilon:
            epsilon = self.epsilon.value if explore else self._parameters.test_epsilon
            actions, exploratory = self._exploration.draw(ideas, epsilon)
        values = self._values(inputs, actions)
        best = selected = values[:, : ideas.shape[1]].argmax(dim=1)
        if exploratory is not None:
            selected = torch.where(exploratory < 0, best, exploratory)
        self._current.record(inputs, actions, values, selected, best)
        if self._context is not None:
            self._context.advance(inputs[:, : self._encoding.inputs])
        return self._current.action.clone()

    def update(self, reward: Tensor) -> Tensor:
        """Learns, as `learn` does; call `end` after."""
        p, before, rate = self._parameters, self._previous, self.learn_rate.value
        if self._maximal_reward is not None:
            reward = unsaturated(reward, self._maximal_reward)
        if p.compares_rewards:
            self._current.record_reward(reward)
        target, learning = td_target(p, reward, before, self._current)
        action = self._encoding.motors(before.action)
        error = self.evaluation.learn(before.state, action, target, learning, rate)
        if self.memory is None or p.repeats_itself:
            return error
        if p.memory_target == "selected":  # with the TD error as learn rate (section 3)
            self.memory.learn(before.state, before.action, error)
        else:  # beyond the paper, the best proposed action
            self.memory.learn(before.state, before.best_action, learning, rate)
        return error

    def end(self) -> None:
        """Ends a step of training: the robots' age grows by one step."""
        self._age += 1

    def forget_step(self, robots: Tensor | None = None) -> None:
        """Prevents learning from the transition to the next step, for robots placed elsewhere.

        A recurrent context goes on, and so does an exploratory action that has begun.

        Args:
          robots: Indices of the robots that are placed elsewhere, shape (n,); None for all.
        """
        self._current.forget(robots)

    def propose(self, state: Tensor) -> Tensor:
        """Returns proposed actions, motor values of shape (B, A, 2).

        A call draws from the brains' random stream, so it changes later steps. Where ideas keep
        their noise for several steps (`Parameters.noise_steps`), a call counts as one step.

        Args:
          state: Sensor signals, shape (B, S).
        """
        if self.memory is not None:
            self.memory.patterns.renew()
        return self._propose(self._inputs(state))

    def values(self, state: Tensor, actions: Tensor) -> Tensor:
        """Returns the values of each robot's A actions in its state, shape (B, A).

        Args:
          state: Sensor signals, shape (B, S).
          actions: Motor values, shape (B, A, 2).
        """
        return self._values(self._inputs(state), actions)

    def _inputs(self, state: Tensor) -> Tensor:
        inputs = self._encoding.state(state)
        return inputs if self._context is None else self._context.joined(inputs)

    def _propose(self, inputs: Tensor) -> Tensor:
        """Returns the actions among which the evaluation network selects (section 3).

        These are all pairs of the fixed motor values, or actions drawn uniformly from [-0.5, 0.5]
        x [-0.5, 0.5], or ideas of the creative memory; beyond the paper, random actions follow the
        ideas (`Parameters.random_share`).
        """
        if self._fixed is not None:
            return self._fixed.expand(len(inputs), -1, -1)
        actions = []
        if self.memory is not None:
            actions = [self.memory.ideas(inputs, self._parameters.own_ideas)]
        if self._random:
            size = len(inputs), self._random, 2
            actions += [torch.rand(size, generator=self.generator, device=inputs.device) - 0.5]
        return torch.cat(actions, dim=1)

    def _values(self, inputs: Tensor, actions: Tensor) -> Tensor:
        return self.evaluation.values(inputs, self._encoding.motors(actions))

    def networks(self) -> dict[str, Tensor]:
        """Returns all weights and biases by name (as "evaluation.hidden_weights"), shapes (B, ...).

        Also returns the connections of a recurrent context ("context.recurrent_weights" and
        "context.input_weights") and the indices of fixed noisy connections ("noise.fixed").
        """
        tensors = _prefixed("evaluation", self.evaluation.networks.tensors())
        if self.memory is not None:
            tensors |= _prefixed("memory", self.memory.networks.tensors())
            if self._parameters.noisy_connections == "fixed":
                tensors["noise.fixed"] = self.memory.patterns.tensors()["fixed"]
        if self._context is not None:
            tensors |= _prefixed("context", self._context.weights())
        return tensors

    def load_networks(self, tensors: Mapping[str, Tensor]) -> None:
        """Overwrites all weights and biases.

        Args:
          tensors: Weights and biases by name, as `networks` returns them. Other names are ignored:
            a brain without a memory can take the networks of a brain with one.

        Raises:
          ValueError: A tensor is missing or has the wrong shape.
        """
        load_into(self.networks(), tensors)

    def state(self) -> dict[str, Tensor]:
        """Returns everything on which the next steps depend, for a checkpoint between two steps.

        The tensors may change in the next step: clone them to keep them.
        """
        state = self.networks() | {"generator": self.generator.get_state()}
        state["age"] = torch.tensor(self._age, device="cpu")
        state |= _prefixed("evaluation.optimizer", self.evaluation.optimizer.tensors())
        state |= _prefixed("exploration", self._exploration.tensors())
        state |= _prefixed("now", self._current.tensors())
        if self.memory is not None:
            state |= _prefixed("memory.optimizer", self.memory.optimizer.tensors())
            state |= _prefixed("noise", self.memory.patterns.tensors())
        if self._context is not None:
            state |= _prefixed("context", self._context.tensors())
        return state

    def load_state(self, tensors: Mapping[str, Tensor]) -> None:
        """Continues from a checkpoint, bit-exactly.

        Args:
          tensors: Tensors by name, as `state` returned them.

        Raises:
          ValueError: A tensor is missing or has the wrong shape.
        """
        state = self.state()
        load_into(state, tensors)
        self.generator.set_state(state["generator"])
        self._age = int(state["age"])


def _prefixed(owner: str, tensors: Mapping[str, Tensor]) -> dict[str, Tensor]:
    return {f"{owner}.{name}": tensor for name, tensor in tensors.items()}
