"""The modular neurocontroller: evaluation network, creative memory, action proposer (section 2)."""

from __future__ import annotations

from collections.abc import Mapping

import torch
from torch import Tensor

from .brains import assemble
from .creative_memory import CreativeMemory
from .networks import load_into
from .parameters import Parameters
from .senses import Senses


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
      memory: Creative memory, which proposes actions; None if no proposed action comes from one.
      generator: Random stream of all draws.
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
        """Draws the initial brains.

        Args:
          parameters: Parameters of the brains.
          proposer: Action proposer, "fixed", "random" or "creative".
          robots: Number B of robots.
          sensors: Number S of sensor signals in a state.
          seed: Seed of the brains' random stream.
          senses: Ranges of the signals; needed with `centred_inputs`, and by brains that need to
            know the maximal smell (`Parameters.needs_maximal_smell`).

        Raises:
          ValueError: The proposer is unknown, or the parameters need senses that are not given.
        """
        self.generator = torch.Generator(torch.get_default_device()).manual_seed(seed)
        parts = assemble(parameters, proposer, robots, sensors, self.generator, senses)
        self.evaluation = parts.evaluation
        self.memory = parts.memory
        self._encoding = parts.encoding
        self._context = parts.context
        self._proposer = parts.proposer
        self._exploration = parts.exploration
        self._target = parts.target
        self._lesson = parts.lesson
        self._epsilon = parts.epsilon
        self._test_epsilon = parameters.test_epsilon
        self._learn_rate = parts.learn_rate
        self._rule = parts.memory.rule if isinstance(parts.memory, CreativeMemory) else None
        self._own_ideas = parameters.own_ideas
        self._age = torch.tensor(0, device="cpu")  # steps of training, read in every step
        self._swapped = False
        inputs = self._encoding.inputs + parameters.context_neurons
        self._before, self._now = (parts.step(robots, inputs) for _ in range(2))

    def act(self, state: Tensor, explore: bool) -> Tensor:
        """Selects each robot's action, epsilon-greedily (section 2).

        Args:
          state: Sensor signals, shape (B, S).
          explore: Whether to explore with the epsilon of training; otherwise with `test_epsilon`.

        Returns:
          Motor values in [-0.5, 0.5], shape (B, 2).
        """
        self.begin()
        return self.select(state, explore)

    def learn(self, reward: Tensor) -> Tensor:
        """Learns from the previous step and from the reward for its action (Eq. 1, section 3).

        Args:
          reward: Reward sensed with the state last given to `act`, shape (B,).

        Returns:
          The TD error, shape (B,); 0 for a robot without a previous step.
        """
        error = self.update(reward)
        self.end()
        return error

    # A step has parts for the host, `begin` and `end`, and parts for the device, `select` and
    # `update`. A GPU can capture the latter and replay them (see `protocols.simulation.device`).

    def begin(self) -> bool:
        """Begins a step: the step that was the present one becomes the previous one.

        Draws what several steps share, and sets what depends on the robots' age.

        Returns:
          Which of the two remembered steps is the present one; they alternate.
        """
        self._proposer.renew()
        self._epsilon.update(self._age)
        self._learn_rate.update(self._age)
        self._before, self._now = self._now, self._before
        self._swapped = not self._swapped
        return self._swapped

    def end(self) -> None:
        """Ends a step of training, which makes the robots older."""
        self._age += 1

    def select(self, state: Tensor, explore: bool) -> Tensor:
        """Selects each robot's action, as `act`, after `begin`.

        Args:
          state: Sensor signals, shape (B, S).
          explore: See `act`.

        Returns:
          Motor values in [-0.5, 0.5], shape (B, 2).
        """
        inputs = self._inputs(state)
        ideas = actions = self._proposer.propose(inputs)
        exploratory = None
        if explore or self._test_epsilon:
            epsilon = self._epsilon.value if explore else self._test_epsilon
            actions, exploratory = self._exploration.draw(ideas, epsilon)
        values = self._values(inputs, actions)
        if explore and self._rule is not None:
            self._rule.update(values[:, : self._own_ideas])
        best = selected = values[:, : ideas.shape[1]].argmax(dim=1)
        if exploratory is not None:
            selected = torch.where(exploratory < 0, best, exploratory)
        self._now.record(inputs, actions, values, selected, best)
        if self._context is not None:
            self._context.advance(inputs[:, : self._encoding.inputs])
        return self._now.action.clone()

    def update(self, reward: Tensor) -> Tensor:
        """Learns, as `learn`, before `end`.

        Args:
          reward: Reward sensed with the state last given to `select`, shape (B,).

        Returns:
          The TD error, shape (B,).
        """
        before, rate = self._before, self._learn_rate.value
        target, learning = self._target(reward, before, self._now)
        action = self._encoding.motors(before.action)
        error = self.evaluation.learn(before.state, action, target, learning, rate)
        if self.memory is not None and self._lesson is not None:
            self.memory.learn(before.state, *self._lesson(before, error, learning, rate))
        return error

    def forget_step(self, robots: Tensor | None = None) -> None:
        """Prevents learning across the next step, for robots that are placed elsewhere.

        A recurrent context and an exploratory action that has begun go on.

        Args:
          robots: Indices of the robots concerned; None for all.
        """
        self._now.forget(robots)

    def propose(self, state: Tensor) -> Tensor:
        """Returns proposed actions, motor values of shape (B, A, 2).

        They are drawn from the brains' random stream, so later steps differ. Where ideas keep their
        noise for several steps (`Parameters.noise_steps`), a call counts as one of them.

        Args:
          state: Sensor signals, shape (B, S).
        """
        self._proposer.renew()
        return self._proposer.propose(self._inputs(state))

    def values(self, state: Tensor, actions: Tensor) -> Tensor:
        """Returns the values of actions, shape (B, A).

        Args:
          state: Sensor signals, shape (B, S).
          actions: Motor values, shape (B, A, 2).
        """
        return self._values(self._inputs(state), actions)

    def _inputs(self, state: Tensor) -> Tensor:
        inputs = self._encoding.state(state)
        return inputs if self._context is None else self._context.joined(inputs)

    def _values(self, inputs: Tensor, actions: Tensor) -> Tensor:
        return self.evaluation.values(inputs, self._encoding.motors(actions))

    def networks(self) -> dict[str, Tensor]:
        """Returns all weights and biases, "evaluation.hidden_weights" etc., shapes (B, ...).

        A noise that is adapted is among them, as "memory.noise_scale", and so are the connections
        of a recurrent context, as "context.recurrent_weights" and "context.input_weights".
        """
        tensors = _prefixed("evaluation", self.evaluation.networks.tensors())
        if self.memory is not None:
            tensors |= _prefixed("memory", self.memory.weights())
        if self._context is not None:
            tensors |= _prefixed("context", self._context.weights())
        return tensors

    def load_networks(self, tensors: dict[str, Tensor]) -> None:
        """Overwrites all weights and biases.

        Args:
          tensors: Weights and biases, named as by `networks`; further ones are ignored, so that a
            brain with another proposer can take them.

        Raises:
          ValueError: A tensor is missing or has the wrong shape.
        """
        load_into(self.networks(), tensors)
        networks = self.evaluation.networks
        if networks.connected is not None:  # the loaded brains may have the removed connections
            networks.disconnect(networks.connected)

    def state(self) -> dict[str, Tensor]:
        """Returns everything on which the next steps depend, for a checkpoint between two steps.

        The tensors may change in the next step: clone them to keep them.
        """
        return self._state_in_place() | self._state_by_value()

    def load_state(self, tensors: dict[str, Tensor]) -> None:
        """Continues from a checkpoint, bit-exactly.

        Args:
          tensors: Tensors that `state` returned.

        Raises:
          ValueError: A tensor is missing or has the wrong shape.
        """
        by_value = self._state_by_value()
        load_into(self._state_in_place() | by_value, tensors)
        self.generator.set_state(by_value.pop("generator"))
        self._now.load({name.removeprefix("now."): t for name, t in by_value.items()})

    def _state_in_place(self) -> dict[str, Tensor]:
        """Returns the tensors that the parts of the brain overwrite in each step."""
        state = self.networks() | {"age": self._age}
        state |= _prefixed("evaluation.optimizer", self.evaluation.optimizer.tensors())
        state |= _prefixed("exploration", self._exploration.tensors())
        if self.memory is not None:
            state |= _prefixed("memory.optimizer", self.memory.optimizer.tensors())
            state |= _prefixed("noise", self.memory.tensors())
        if self._context is not None:
            state |= _prefixed("context", self._context.tensors())
        return state

    def _state_by_value(self) -> dict[str, Tensor]:
        """Returns copies of the state that each step replaces."""
        return {"generator": self.generator.get_state()} | _prefixed("now", self._now.tensors())


def _prefixed(owner: str, tensors: Mapping[str, Tensor]) -> dict[str, Tensor]:
    return {f"{owner}.{name}": tensor for name, tensor in tensors.items()}
