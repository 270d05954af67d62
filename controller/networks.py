"""One-hidden-layer networks, one for each of B robots, and their gradient by hand."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import Literal

import torch
from torch import Tensor

ActivationName = Literal["logistic", "tanh"]


@dataclasses.dataclass(frozen=True)
class Activation:
    """What hidden neurons do with their sums.

    Attributes:
      apply: turns sums into activations, in place.
      back: an error at the activations (first) times their slope there, from the activations
        themselves (second).
    """

    apply: Callable[[Tensor], Tensor]
    back: Callable[[Tensor, Tensor], Tensor]


ACTIVATIONS: dict[ActivationName, Activation] = {
    "logistic": Activation(Tensor.sigmoid_, lambda error, hidden: error * hidden * (1 - hidden)),
    "tanh": Activation(Tensor.tanh_, lambda error, hidden: error * (1 - hidden * hidden)),
}


class Networks:
    """B feed-forward networks of equal shape: one layer of hidden neurons, linear output sums.

    What follows the output sums (identity in the evaluation network, a logistic function in
    the creative memory) is its owner's.

    Attributes:
      hidden_weights: shape (B, H, I).
      hidden_biases: shape (B, H).
      output_weights: shape (B, O, H).
      output_biases: shape (B, O).
      activation: of the hidden neurons.
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
        activation: ActivationName = "logistic",
    ) -> None:
        """Draws all weights and biases uniformly from [-initial_range, initial_range]."""

        def draw(*shape: int) -> Tensor:
            return (torch.rand(robots, *shape, generator=generator) * 2 - 1) * initial_range

        self.activation = ACTIVATIONS[activation]
        self.hidden_weights = draw(hidden, inputs)
        self.hidden_biases = draw(hidden)
        self.output_weights = draw(outputs, hidden)
        self.output_biases = draw(outputs)

    def forward(self, inputs: Tensor) -> tuple[Tensor, Tensor]:
        """Evaluates each robot's network at one input.

        Args:
          inputs: shape (B, I).

        Returns:
          The hidden activations, shape (B, H), and the output sums, shape (B, O).
        """
        sums = torch.baddbmm(self.hidden_biases[..., None], self.hidden_weights, inputs[..., None])
        hidden = self.activation.apply(sums)
        output = torch.baddbmm(self.output_biases[..., None], self.output_weights, hidden)
        return hidden[..., 0], output[..., 0]

    def ascend(self, inputs: Tensor, hidden: Tensor, steps: Tensor) -> None:
        """Adds to every weight w: sum over outputs o of steps_o * d(output sum o) / dw.

        Args:
          inputs: where the networks were evaluated, shape (B, I).
          hidden: their hidden activations there, shape (B, H).
          steps: how far to go for each output sum, shape (B, O).
        """
        back = self._back(hidden, steps)
        self.output_weights.baddbmm_(steps[..., None], hidden[:, None])
        self.output_biases += steps
        self.hidden_weights.baddbmm_(back[..., None], inputs[:, None])
        self.hidden_biases += back

    def gradient(self, inputs: Tensor, hidden: Tensor, steps: Tensor) -> Tensor:
        """What `ascend` adds, all weights of a robot side by side in the order of `NAMES`.

        Args:
          inputs: see `ascend`.
          hidden: see `ascend`.
          steps: see `ascend`.

        Returns:
          Shape (B, P), of P weights and biases a robot.
        """
        back = self._back(hidden, steps)
        to_hidden = (back[..., None] * inputs[:, None]).flatten(1)
        to_output = (steps[..., None] * hidden[:, None]).flatten(1)
        return torch.cat([to_hidden, back, to_output, steps], dim=1)

    def add(self, steps: Tensor) -> None:
        """Adds to every weight its step, shape (B, P), side by side as in `gradient`."""
        tensors = list(self.tensors().values())
        parts = steps.split([tensor[0].numel() for tensor in tensors], dim=1)
        for tensor, part in zip(tensors, parts, strict=True):
            tensor += part.view(tensor.shape)

    def _back(self, hidden: Tensor, steps: Tensor) -> Tensor:
        """The steps of the output sums, carried back to the hidden sums, shape (B, H)."""
        error = torch.bmm(steps[:, None], self.output_weights)[:, 0]
        return self.activation.back(error, hidden)

    def tensors(self) -> dict[str, Tensor]:
        """The weights and biases themselves, by name."""
        return {name: getattr(self, name) for name in self.NAMES}

    def load(self, tensors: dict[str, Tensor]) -> None:
        """Overwrites weights and biases.

        Raises:
          ValueError: one is missing, or its shape is another.
        """
        load_into(self.tensors(), tensors)


def load_into(targets: dict[str, Tensor], tensors: dict[str, Tensor]) -> None:
    """Copies tensors into targets of the same names and shapes: all of them, or none.

    Raises:
      ValueError: one is missing, or its shape is another.
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
