"""The creative memory: recalled actions, and ideas made by noise in its connections (section 3)."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Protocol

import torch
from torch import Tensor

from .extensions.success_rule import SuccessRule
from .networks import ACTIVATIONS, Networks
from .noise import HeldNoisePatterns, NoisePatterns
from .optimizers import SGD, Optimizer, Rate
from .parameters import Parameters
from .step import Step

# Takes a step, its TD error, 1 or 0 for a robot that learns or does not, and the learn rate of the
# evaluation network. Returns the memory's target action, each robot's learn rate, and a factor by
# which all of these rates are multiplied.
Lesson = Callable[[Step, Tensor, Tensor, Rate], tuple[Tensor, Tensor, Rate]]


def selected_action(
    before: Step, error: Tensor, learning: Tensor, rate: Rate
) -> tuple[Tensor, Tensor, Rate]:
    """Returns the selected action, with the TD error as learn rate, as in the paper.

    Args:
      before: Step at time t.
      error: TD error of the step, shape (B,).
      learning: 1 for a robot that learns, 0 for one that does not, shape (B,).
      rate: Learn rate of the evaluation network.
    """
    del learning, rate  # the TD error is 0 for a robot that does not learn
    return before.action, error, 1.0


class Memory(Protocol):
    """Networks that propose actions, and learn which actions to propose.

    Attributes:
      networks: The networks, one for each of B robots.
      optimizer: Optimizer of the networks.
    """

    networks: Networks
    optimizer: Optimizer

    def renew(self) -> None:
        """Draws what several steps share, if it is time; to be called before `ideas`."""
        ...

    def ideas(self, state: Tensor, count: int) -> Tensor:
        """Returns A ideas, motor values of shape (B, A, 2), for network inputs, shape (B, I)."""
        ...

    def recall(self, state: Tensor) -> Tensor:
        """Returns the main idea, motor values of shape (B, 2), for network inputs, shape (B, I)."""
        ...

    def learn(self, state: Tensor, action: Tensor, factors: Tensor, rate: Rate = 1.0) -> None:
        """Learns an action, shape (B, 2), at `rate` times each robot's factor, shape (B,)."""
        ...

    def weights(self) -> Mapping[str, Tensor]:
        """Returns the tensors that decide what is proposed, by name; not copies."""
        ...

    def tensors(self) -> Mapping[str, Tensor]:
        """Returns further tensors kept from step to step, for a checkpoint."""
        ...


class CreativeMemory:
    """Networks that map a state to two logistic outputs, the motor values (section 3).

    Attributes:
      networks: The networks, one for each of B robots.
      optimizer: Optimizer of the networks.
      patterns: Draws the noise patterns; each idea gets one pattern.
      rule: Rule that adapts the noise; None if it is constant.
    """

    def __init__(
        self,
        parameters: Parameters,
        robots: int,
        inputs: int,
        generator: torch.Generator,
        optimizer: Callable[[Networks], Optimizer] = SGD,
    ) -> None:
        """Draws the initial networks.

        Args:
          parameters: Parameters of the brain.
          robots: Number B of robots.
          inputs: Number I of network inputs.
          generator: Random stream of the initial weights and of the noise.
          optimizer: Class of the optimizer.
        """
        self._parameters = parameters
        hidden, initial_range = parameters.memory_hidden, parameters.initial_range
        self.networks = Networks(robots, inputs, hidden, 2, initial_range, generator)
        self.networks.activation = ACTIVATIONS[parameters.activation]
        self.optimizer = optimizer(self.networks)
        # Numbers of connections, in the order of a pattern: sensor, motor weights (and biases).
        self._sizes = [hidden * inputs, 2 * hidden]
        if parameters.noise_on_biases:
            self._sizes += [hidden, 2]
        patterns = NoisePatterns(
            sum(self._sizes), parameters.noisy_share, parameters.noise, generator
        )
        self.patterns: NoisePatterns | HeldNoisePatterns = patterns
        if parameters.noise_steps != 1:
            count = robots * parameters.own_ideas
            self.patterns = HeldNoisePatterns(patterns, count, parameters.noise_steps)
        rate = parameters.noise_adaptation
        self.rule = SuccessRule(robots, rate) if rate else None

    def renew(self) -> None:
        """See `Memory.renew`."""
        self.patterns.renew()

    def ideas(self, state: Tensor, count: int) -> Tensor:
        """Returns ideas: actions of the memory, each with its own noise in the connections.

        Args:
          state: Network inputs, shape (B, I).
          count: Number A of ideas per robot.

        Returns:
          Motor values in [-0.5, 0.5], shape (B, A, 2).
        """
        robots, inputs = state.shape
        hidden_size = self._parameters.memory_hidden
        patterns = self.patterns.draw(robots * count).view(robots, count, -1)
        if self._parameters.keep_main_idea:
            patterns[:, 0].zero_()
        if self.rule is not None:
            patterns *= self.rule.scale[..., None]
        noise = patterns.split(self._sizes, dim=-1)
        net = self.networks

        # (W + N) x = W x + N x: adding the sums avoids building the noisy networks.
        main = torch.baddbmm(net.hidden_biases[..., None], net.hidden_weights, state[..., None])
        noise_in = noise[0].reshape(robots, count * hidden_size, inputs)
        sums = torch.bmm(noise_in, state[..., None]).view(robots, count, hidden_size)
        sums += main.mT
        if self._parameters.noise_on_biases:
            sums += noise[2]
        hidden = net.activation.apply(sums)

        outputs = torch.baddbmm(net.output_biases[:, None], hidden, net.output_weights.mT)
        noise_out = noise[1].view(robots, count, 2, hidden_size)
        outputs += (noise_out * hidden[:, :, None]).sum(-1)
        if self._parameters.noise_on_biases:
            outputs += noise[3]
        return outputs.sigmoid_() - 0.5

    def recall(self, state: Tensor) -> Tensor:
        """Returns the main idea, the action without noise.

        Args:
          state: Network inputs, shape (B, I).

        Returns:
          Motor values in [-0.5, 0.5], shape (B, 2).
        """
        return self.networks.forward(state)[1].sigmoid() - 0.5

    def learn(self, state: Tensor, action: Tensor, factors: Tensor, rate: Rate = 1.0) -> None:
        """Learns an action by one step of back-propagation on half the squared error.

        Args:
          state: Network inputs, shape (B, I).
          action: Motor values to learn, shape (B, 2).
          factors: Factor of each robot's learn rate, shape (B,); negative to unlearn the action, 0
            for a robot that does not learn. With Adam only 1 or 0.
          rate: Learn rate.
        """
        hidden, sums = self.networks.forward(state)
        outputs = sums.sigmoid()
        steps = factors[:, None] * (action + 0.5 - outputs) * outputs * (1 - outputs)
        self.optimizer.ascend(state, hidden, steps, rate, factors)

    def weights(self) -> Mapping[str, Tensor]:
        """Returns weights, biases and the adapted noise, not copies, by name."""
        adapted = {} if self.rule is None else {"noise_scale": self.rule.scale}
        return self.networks.tensors() | adapted

    def tensors(self) -> Mapping[str, Tensor]:
        """Returns the noise patterns that are kept, for a checkpoint."""
        return self.patterns.tensors()
