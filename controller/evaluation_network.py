"""The evaluation network: values of state-action pairs, learned by TD(0) (section 2, Eq. 1)."""

from __future__ import annotations

import torch
from torch import Tensor

from .networks import ACTIVATIONS, SGD, Adam, Networks, Optimizer, Rate
from .parameters import Parameters
from .step import Step


class EvaluationNetwork:
    """Networks that map a state and two motor values to one value (section 3).

    Attributes:
      networks: One network for each of B robots.
      optimizer: Optimizer of the networks, `SGD` or `Adam`.
    """

    def __init__(
        self, parameters: Parameters, robots: int, inputs: int, generator: torch.Generator
    ) -> None:
        """Draws the initial networks.

        Args:
          parameters: Parameters of the brain; `evaluation_hidden`, `initial_range`, `activation`
            and `optimizer` are used.
          robots: Number B of robots.
          inputs: Number I of network inputs for the state.
          generator: Random stream of the initial weights.
        """
        self._inputs = inputs
        hidden, initial_range = parameters.evaluation_hidden, parameters.initial_range
        self.networks = Networks(robots, inputs + 2, hidden, 1, initial_range, generator)
        self.networks.activation = ACTIVATIONS[parameters.activation]
        adam = parameters.optimizer == "adam"
        self.optimizer: Optimizer = Adam(self.networks) if adam else SGD(self.networks)

    def values(self, state: Tensor, actions: Tensor) -> Tensor:
        """Returns the values of each robot's A actions in its state, shape (B, A).

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
        self, state: Tensor, action: Tensor, target: Tensor, learning: Tensor, rate: Rate
    ) -> Tensor:
        """Learns from one step by TD(0) (Eq. 1): w += eta [target - V] grad V.

        V and its gradient are computed with the weights before this update.

        Args:
          state: Network inputs for the state at time t, shape (B, I).
          action: Network inputs for the action selected at time t, shape (B, 2).
          target: Target of the value, see `td_target`, shape (B,).
          learning: 1 for a robot that learns, 0 for one that does not, shape (B,).
          rate: Learn rate eta: a number, or a tensor of shape ().

        Returns:
          The TD error, shape (B,); 0 for a robot that does not learn.
        """
        inputs = torch.cat([state, action], dim=-1)
        hidden, value = self.networks.forward(inputs)
        error = learning * (target - value[:, 0])
        self.optimizer.ascend(inputs, hidden, error[:, None], rate, learning)
        return error


def td_target(p: Parameters, reward: Tensor, before: Step, now: Step) -> tuple[Tensor, Tensor]:
    """Returns the target r + gamma V of Eq. 1, with reward and value at time t + 1.

    The paper's target has the value of the selected action (SARSA). Beyond the paper,
    `reward_form`, `bootstrap`, `clipped_bootstrap` and `advantage_scale` each change one term.

    Args:
      p: Parameters of the brain.
      reward: Reward sensed at time t + 1, shape (B,); if `p.raw_reward`, the unsaturated one.
      before: Step at time t, whose action led to the reward.
      now: Step at time t + 1; if `p.compares_rewards`, it has recorded the reward.

    Returns:
      The targets; and 1 for each robot that has a target, else 0; both of shape (B,).
    """
    learning = before.chained
    value = now.best_value if p.bootstrap == "max" else now.value
    if p.compares_rewards:
        learning = learning * before.rewarded
    if p.clipped_bootstrap:
        # Where the reward fell to 0 or below, V is at most max(reward before, 0).
        lost = (now.reward < before.reward) & (now.reward <= 0)
        value = torch.where(lost, torch.minimum(value, before.reward.clamp(min=0)), value)
    if p.reward_form == "difference":
        reward = reward - before.reward
    if p.advantage_scale:  # an exploratory action better than every idea is not rewarded more
        worse = (before.best_value - before.value).clamp(min=0)
        reward = reward - p.advantage_scale * worse
    return reward + p.discount * value, learning
