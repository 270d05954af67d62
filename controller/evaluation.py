"""The evaluation network: the value of a motor action in a state, learnt by TD(0) (Eq. 1)."""

from __future__ import annotations

import torch
from torch import Tensor

from .networks import Networks
from .optimizers import make_optimizer
from .parameters import Parameters


class EvaluationNetwork:
    """State and two motor values in, one layer of hidden neurons, one value out (section 3).

    Attributes:
      networks: give the values of actions, and learn.
      optimizer: moves the networks.
    """

    def __init__(
        self, parameters: Parameters, robots: int, sensors: int, generator: torch.Generator
    ) -> None:
        """Draws B networks for states of S sensors."""
        self._parameters = parameters
        self._sensors = sensors
        self.networks = Networks(
            robots,
            sensors + 2,
            parameters.evaluation_hidden,
            1,
            parameters.initial_range,
            generator,
            parameters.activation,
        )
        self.optimizer = make_optimizer(parameters.optimizer, self.networks)

    def values(self, state: Tensor, actions: Tensor) -> Tensor:
        """The values of several actions in one state.

        Args:
          state: sensor signals, shape (B, S).
          actions: motor values, shape (B, A, 2).

        Returns:
          The values, shape (B, A).
        """
        net = self.networks
        by_state = net.hidden_weights[..., : self._sensors]
        by_motor = net.hidden_weights[..., self._sensors :]
        sums = torch.baddbmm(net.hidden_biases[..., None], by_state, state[..., None])
        hidden = net.activation.apply(torch.baddbmm(sums.mT, actions, by_motor.mT))
        return torch.baddbmm(net.output_biases[..., None], hidden, net.output_weights.mT)[..., 0]

    def learn(
        self,
        state: Tensor,
        action: Tensor,
        reward: Tensor,
        next_value: Tensor,
        learning: Tensor | float = 1.0,
        rate: float | None = None,
    ) -> Tensor:
        """One step of TD(0), Eq. 1: w += eta [r + gamma V' - V] grad V.

        V and its gradient are taken with the weights as they are now.

        Args:
          state: at time t, shape (B, S).
          action: selected at time t, shape (B, 2).
          reward: at time t + 1, shape (B,).
          next_value: V of the state and the action selected at time t + 1, shape (B,).
          learning: 1 for a robot that learns, 0 for one that does not, shape (B,).
          rate: the learn rate; None for the parameters'.

        Returns:
          The TD error, shape (B,), within its limit; 0 for a robot that does not learn.
        """
        inputs = torch.cat([state, action], dim=-1)
        hidden, value = self.networks.forward(inputs)
        error = learning * (reward + self._parameters.discount * next_value - value[:, 0])
        if (limit := self._parameters.error_limit) is not None:
            error = error.clamp(-limit, limit)
        rate = self._parameters.learn_rate if rate is None else rate
        self.optimizer.ascend(inputs, hidden, error[:, None], rate, learning)
        return error
