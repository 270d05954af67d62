"""One-hidden-layer networks, one for each of B robots, and their gradients (section 3)."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping

import torch
from torch import Tensor


@dataclasses.dataclass(frozen=True)
class Activation:
    """An activation function of hidden neurons.

    Attributes:
      apply: Function that turns sums into activations, in place.
      back: Function that takes the error at the activations, and the activations; it returns the
        error at the sums.
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
      hidden_weights: Weights from inputs to hidden neurons, shape (B, H, I).
      hidden_biases: Biases of the hidden neurons, shape (B, H).
      output_weights: Weights from hidden to output neurons, shape (B, O, H).
      output_biases: Biases of the output neurons, shape (B, O).
      activation: Activation function of the hidden neurons; logistic unless replaced.
      connected: 1 where a hidden neuron receives an input, else 0, shape (H, I); None if each
        receives all.
    """

    NAMES = ("hidden_weights", "hidden_biases", "output_weights", "output_biases")

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

        def draw(*shape: int) -> Tensor:
            return (torch.rand(robots, *shape, generator=generator) * 2 - 1) * initial_range

        self.activation = ACTIVATIONS["logistic"]
        self.hidden_weights = draw(hidden, inputs)
        self.hidden_biases = draw(hidden)
        self.output_weights = draw(outputs, hidden)
        self.output_biases = draw(outputs)
        self.connected: Tensor | None = None

    def disconnect(self, connected: Tensor) -> None:
        """Removes connections from inputs to hidden neurons, for good: their weights stay 0.

        Args:
          connected: 1 for a connection that stays, else 0, shape (H, I).
        """
        self.connected = connected
        self.hidden_weights *= connected

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
          steps: Factor for the gradient of each output sum, shape (B, O).
        """
        back = self._back(hidden, steps)
        self.output_weights.baddbmm_(steps[..., None], hidden[:, None])
        self.output_biases += steps
        if self.connected is None:
            self.hidden_weights.baddbmm_(back[..., None], inputs[:, None])
        else:
            self.hidden_weights += back[..., None] * inputs[:, None] * self.connected
        self.hidden_biases += back

    def gradient(self, inputs: Tensor, hidden: Tensor, steps: Tensor) -> Tensor:
        """Returns what `ascend` adds, as one vector per robot in the order of `NAMES`.

        Args:
          inputs: Network inputs, shape (B, I).
          hidden: Hidden activations at these inputs, shape (B, H).
          steps: Factor for the gradient of each output sum, shape (B, O).

        Returns:
          The gradient with respect to the P weights and biases of a robot, shape (B, P).
        """
        back = self._back(hidden, steps)
        to_hidden = back[..., None] * inputs[:, None]
        if self.connected is not None:
            to_hidden *= self.connected
        to_hidden = to_hidden.flatten(1)
        to_output = (steps[..., None] * hidden[:, None]).flatten(1)
        return torch.cat([to_hidden, back, to_output, steps], dim=1)

    def add(self, steps: Tensor) -> None:
        """Adds to every weight its step.

        Args:
          steps: Step of every weight, in the order of `gradient`, shape (B, P).
        """
        tensors = list(self.tensors().values())
        parts = steps.split([tensor[0].numel() for tensor in tensors], dim=1)
        for tensor, part in zip(tensors, parts, strict=True):
            tensor += part.view(tensor.shape)

    def _back(self, hidden: Tensor, steps: Tensor) -> Tensor:
        """Propagates steps of the output sums back to the hidden sums, shape (B, H)."""
        error = torch.bmm(steps[:, None], self.output_weights)[:, 0]
        return self.activation.back(error, hidden)

    def tensors(self) -> dict[str, Tensor]:
        """Returns the weights and biases themselves, not copies, by name."""
        return {name: getattr(self, name) for name in self.NAMES}


def load_into(targets: Mapping[str, Tensor], tensors: Mapping[str, Tensor]) -> None:
    """Copies tensors into targets of the same names and shapes: all of them, or none.

    Args:
      targets: Tensors to overwrite, by name.
      tensors: Tensors to copy, by name.

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
