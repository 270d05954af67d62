"""The evaluation network: values of state-action pairs, learned by TD(0) (section 2, Eq. 1)."""

from __future__ import annotations

from collections.abc import Callable
from typing import Protocol

import torch
from torch import Tensor

from .networks import ACTIVATIONS, Networks
from .optimizers import SGD, Optimizer, Rate
from .parameters import Parameters
from .step import Step


def td_error(target: Tensor, value: Tensor, learning: Tensor) -> Tensor:
    """Returns the TD error of Eq. 1, shape (B,).

    Args:
      target: Target of the value, shape (B,).
      value: Value of the selected action, shape (B,).
      learning: 1 for a robot that learns, 0 for one that does not, shape (B,).
    """
    return learning * (target - value)


class Target(Protocol):
    """Computes the target of the value V_t in Eq. 1."""

    def __call__(self, reward: Tensor, before: Step, now: Step) -> tuple[Tensor, Tensor]:
        """Returns the targets, and 1 for each robot that has a target (else 0), both of shape (B,).

        Args:
          reward: Reward signal at time t + 1, shape (B,).
          before: Step at time t.
          now: Step at time t + 1.
        """
        ...


def on_policy(before: Step, now: Step) -> Tensor:
    """Returns V at t + 1 of SARSA, the value of the selected action, shape (B,).

    Args:
      before: Step at time t.
      now: Step at time t + 1.
    """
    del before
    return now.value


class TDTarget:
    """The target r + gamma V of TD(0), with reward and value at time t + 1 (Eq. 1)."""

    def __init__(
        self, discount: float, next_value: Callable[[Step, Step], Tensor] = on_policy
    ) -> None:
        """Takes the parts of the target.

        Args:
          discount: Discount factor gamma.
          next_value: Function of the steps at t and t + 1 that returns V at t + 1.
        """
        self._discount = discount
        self._next_value = next_value

    def __call__(self, reward: Tensor, before: Step, now: Step) -> tuple[Tensor, Tensor]:
        """See `Target.__call__`."""
        return reward + self._discount * self._next_value(before, now), before.chained


class EvaluationNetwork:
    """Networks that map a state and two motor values to one value (section 3).

    Attributes:
      networks: The networks, one for each of B robots.
      optimizer: Optimizer of the networks.
    """

    def __init__(
        self,
        parameters: Parameters,
        robots: int,
        inputs: int,
        generator: torch.Generator,
        optimizer: Callable[[Networks], Optimizer] = SGD,
        td_error: Callable[[Tensor, Tensor, Tensor], Tensor] = td_error,
    ) -> None:
        """Draws the initial networks.

        Args:
          parameters: Parameters of the brain.
          robots: Number B of robots.
          inputs: Number I of network inputs for the state.
          generator: Random stream of the initial weights.
          optimizer: Class of the optimizer.
          td_error: Function that computes the TD error.
        """
        self._inputs = inputs
        self._td_error = td_error
        hidden, initial_range = parameters.evaluation_hidden, parameters.initial_range
        self.networks = Networks(robots, inputs + 2, hidden, 1, initial_range, generator)
        self.networks.activation = ACTIVATIONS[parameters.activation]
        self.optimizer = optimizer(self.networks)

    def values(self, state: Tensor, actions: Tensor) -> Tensor:
        """Returns the values of several actions in one state, shape (B, A).

        Args:
          state: Network inputs for the state, shape (B, I).
          actions: Network inputs for the motor values, shape (B, A, 2).
        """
        net = self.networks
        by_state = net.hidden_weights[..., : self._inputs]
        by_motor = net.hidden_weights[..., self._inputs :]
        sums = torch.baddbmm(net.hidden_biases[..., None], by_state, state[..., None])
        hidden = net.activation.apply(torch.baddbmm(sums.mT, actions, by_motor.mT))
        return torch.baddbmm(net.output_biases[..., None], hidden, net.output_weights.mT)[..., 0]

    def learn(
        self,
        state: Tensor,
        action: Tensor,
        target: Tensor,
        learning: Tensor,
        rate: Rate,
    ) -> Tensor:
        """Learns from one step by TD(0) (Eq. 1): w += eta [target - V] grad V.

        V and its gradient are computed with the weights before this update.

        Args:
          state: Network inputs for the state at time t, shape (B, I).
          action: Network inputs for the action selected at time t, shape (B, 2).
          target: Target of the value, r + gamma V at time t + 1, shape (B,).
          learning: 1 for a robot that learns, 0 for one that does not, shape (B,).
          rate: Learn rate eta.

        Returns:
          The TD error, shape (B,); 0 for a robot that does not learn.
        """
        inputs = torch.cat([state, action], dim=-1)
        hidden, value = self.networks.forward(inputs)
        error = self._td_error(target, value[:, 0], learning)
        self.optimizer.ascend(inputs, hidden, error[:, None], rate, learning)
        return error
