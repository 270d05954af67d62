"""One-hidden-layer networks, one for each of B robots, and their optimizers (section 3).

The networks with logistic hidden neurons and the plain gradient step are the paper's; hyperbolic
tangents and Adam go beyond it.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping

import torch
from torch import Tensor

Rate = float | Tensor  # a learn rate; a tensor of shape () for steps captured as CUDA graphs


@dataclasses.dataclass(frozen=True)
class Activation:
    """An activation function of hidden neurons.

    Attributes:
      apply: Function that replaces the neurons' sums by their activations, in place.
      back: Function for back-propagation. It takes two arguments, the errors of the activations
        and the activations themselves, and returns the errors of the neurons' sums.
    """

    apply: Callable[[Tensor], Tensor]
    back: Callable[[Tensor, Tensor], Tensor]


ACTIVATIONS: Mapping[str, Activation] = {
    "logistic": Activation(Tensor.sigmoid_, lambda error, hidden: error * hidden * (1 - hidden)),
    "tanh": Activation(Tensor.tanh_, lambda error, hidden: error * (1 - hidden * hidden)),
}


class Networks:
    """B feed-forward networks of equal shape: one layer of hidden neurons, linear output sums.

    The owner applies the output function: the identity in the evaluation network, the logistic
    function in the creative memory.

    Attributes:
      weights: All P weights and biases of each robot, shape (B, P); `hidden_weights` to
        `output_biases` are views of it.
      hidden_weights: Weights from inputs to hidden neurons, shape (B, H, I).
      hidden_biases: Biases of the hidden neurons, shape (B, H).
      output_weights: Weights from hidden to output neurons, shape (B, O, H).
      output_biases: Biases of the output neurons, shape (B, O).
      activation: Activation function of the hidden neurons; logistic unless replaced.
    """

    def __init__(
        self,
        robots: int,
        inputs: int,
        hidden: int,
        outputs: int,
        initial_range: float,
        generator: torch.Generator,
    ) -> None:
        """Draws all weights and biases uniformly from [-initial_range, initial_range].

        Args:
          robots: Number B of networks.
          inputs: Number I of inputs.
          hidden: Number H of hidden neurons.
          outputs: Number O of outputs.
          initial_range: Half-width of the interval around 0 from which initial weights are drawn.
          generator: Random stream of the initial weights.
        """
        shapes = (hidden, inputs), (hidden,), (outputs, hidden), (outputs,)
        drawn = [torch.rand(robots, *shape, generator=generator) for shape in shapes]
        self.weights = (torch.cat([part.flatten(1) for part in drawn], dim=1) * 2 - 1).mul_(
            initial_range
        )
        parts = self.weights.split([part[0].numel() for part in drawn], dim=1)
        self.hidden_weights = parts[0].view(robots, hidden, inputs)
        self.hidden_biases = parts[1]
        self.output_weights = parts[2].view(robots, outputs, hidden)
        self.output_biases = parts[3]
        self.activation = ACTIVATIONS["logistic"]

    def forward(self, inputs: Tensor) -> tuple[Tensor, Tensor]:
        """Evaluates each robot's network at one input.

        Args:
          inputs: Network inputs, shape (B, I).

        Returns:
          The hidden activations, shape (B, H), and the output sums, shape (B, O).
        """
        sums = torch.baddbmm(self.hidden_biases[..., None], self.hidden_weights, inputs[..., None])
        hidden = self.activation.apply(sums)
        output = torch.baddbmm(self.output_biases[..., None], self.output_weights, hidden)
        return hidden[..., 0], output[..., 0]

    def ascend(self, inputs: Tensor, hidden: Tensor, steps: Tensor) -> None:
        """Adds to every weight w the sum over outputs o of steps_o * d(output sum o) / dw.

        Args:
          inputs: Network inputs, shape (B, I).
          hidden: Hidden activations at these inputs, shape (B, H).
          steps: Factor steps_o of the gradient of each output sum o, shape (B, O).
        """
        back = self._back(hidden, steps)
        self.output_weights.baddbmm_(steps[..., None], hidden[:, None])
        self.output_biases += steps
        self.hidden_weights.baddbmm_(back[..., None], inputs[:, None])
        self.hidden_biases += back

    def gradient(self, inputs: Tensor, hidden: Tensor, steps: Tensor) -> Tensor:
        """Returns what `ascend` adds to `weights`, shape (B, P), for the same arguments."""
        back = self._back(hidden, steps)
        to_hidden = (back[..., None] * inputs[:, None]).flatten(1)
        to_output = (steps[..., None] * hidden[:, None]).flatten(1)
        return torch.cat([to_hidden, back, to_output, steps], dim=1)

    def _back(self, hidden: Tensor, steps: Tensor) -> Tensor:
        """Propagates steps of the output sums back to the hidden sums, shape (B, H)."""
        error = torch.bmm(steps[:, None], self.output_weights)[:, 0]
        return self.activation.back(error, hidden)

    def tensors(self) -> dict[str, Tensor]:
        """Returns the weights and biases themselves, not copies, by name."""
        names = ("hidden_weights", "hidden_biases", "output_weights", "output_biases")
        return {name: getattr(self, name) for name in names}


class SGD:
    """Plain gradient steps: the gradient times the learn rate (Eq. 1)."""

    def __init__(self, networks: Networks) -> None:
        """Takes the networks that it will train."""
        self._networks = networks

    def ascend(
        self, inputs: Tensor, hidden: Tensor, steps: Tensor, rate: Rate, learning: Tensor
    ) -> None:
        """Moves the weights of every robot's network along the gradient of its output sums.

        An output sum is what an output neuron sums up, before its activation function.

        Args:
          inputs: Network inputs, shape (B, I).
          hidden: Hidden activations at these inputs, shape (B, H).
          steps: Errors of the output sums, shape (B, O); 0 for robots that do not learn.
          rate: Learn rate, by which the steps are multiplied: a number, or a tensor of shape ().
          learning: 1 for a robot that learns, 0 for one that does not, shape (B,).
        """
        del learning  # steps of 0 change no weight
        self._networks.ascend(inputs, hidden, rate * steps)

    def tensors(self) -> dict[str, Tensor]:
        """Returns the tensors kept from step to step, for a checkpoint: none."""
        return {}


class Adam:
    """Adam (Kingma and Ba, ICLR 2015), with separate moments for each robot."""

    MEAN_DECAY = 0.9
    SQUARE_DECAY = 0.999
    EPSILON = 1e-8

    def __init__(self, networks: Networks) -> None:
        """Takes the networks that it will train."""
        self._networks = networks
        self._mean = torch.zeros_like(networks.weights)
        self._square = torch.zeros_like(networks.weights)
        self._steps = torch.zeros(len(networks.weights), 1)

    def ascend(
        self, inputs: Tensor, hidden: Tensor, steps: Tensor, rate: Rate, learning: Tensor
    ) -> None:
        """Moves the weights of the robots that learn; see `SGD.ascend`."""
        gradient = self._networks.gradient(inputs, hidden, steps)
        on = learning[:, None]
        self._steps += on
        self._mean += (1 - self.MEAN_DECAY) * on * (gradient - self._mean)
        self._square += (1 - self.SQUARE_DECAY) * on * (gradient.square_() - self._square)
        # Both moments start at zero; the powers correct this bias.
        count = self._steps.clamp(min=1)
        rates = rate * on / (1 - self.MEAN_DECAY**count)
        root = (self._square / (1 - self.SQUARE_DECAY**count)).sqrt_()
        self._networks.weights += rates * self._mean / root.add_(self.EPSILON)

    def tensors(self) -> dict[str, Tensor]:
        """Returns the moments, and each robot's number of updates, for a checkpoint."""
        return {"mean": self._mean, "square": self._square, "steps": self._steps}


Optimizer = SGD | Adam


def load_into(targets: Mapping[str, Tensor], tensors: Mapping[str, Tensor]) -> None:
    """Copies tensors into targets of the same names and shapes: all of them, or none.

    Args:
      targets: Tensors to overwrite, by name.
      tensors: Tensors to copy, by name; names that `targets` lacks are ignored.

    Raises:
      ValueError: A tensor is missing or has the wrong shape.
    """
    for name, target in targets.items():
        if name not in tensors:
            raise ValueError(f"{name} is missing")
        if tensors[name].shape != target.shape:
            raise ValueError(
                f"{name} must have shape {tuple(target.shape)}, got {tuple(tensors[name].shape)}"
            )
    for name, target in targets.items():
        target.copy_(tensors[name])
