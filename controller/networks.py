"""One-hidden-layer networks, one for each of B robots, and their gradient by hand."""

from __future__ import annotations

import torch
from torch import Tensor


class Networks:
    """B feed-forward networks of equal shape: logistic hidden neurons, linear output sums.

    What follows the output sums (identity in the evaluation network, a logistic function in
    the creative memory) is its owner's.

    Attributes:
      hidden_weights: shape (B, H, I).
      hidden_biases: shape (B, H).
      output_weights: shape (B, O, H).
      output_biases: shape (B, O).
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
        """Draws all weights and biases uniformly from [-initial_range, initial_range]."""

        def draw(*shape: int) -> Tensor:
            return (torch.rand(robots, *shape, generator=generator) * 2 - 1) * initial_range

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
        hidden = sums.sigmoid_()
        output = torch.baddbmm(self.output_biases[..., None], self.output_weights, hidden)
        return hidden[..., 0], output[..., 0]

    def ascend(self, inputs: Tensor, hidden: Tensor, steps: Tensor) -> None:
        """Adds to every weight w: sum over outputs o of steps_o * d(output sum o) / dw.

        Args:
          inputs: where the networks were evaluated, shape (B, I).
          hidden: their hidden activations there, shape (B, H).
          steps: how far to go for each output sum, shape (B, O).
        """
        back = torch.bmm(steps[:, None], self.output_weights)[:, 0] * hidden * (1 - hidden)
        self.output_weights.baddbmm_(steps[..., None], hidden[:, None])
        self.output_biases += steps
        self.hidden_weights.baddbmm_(back[..., None], inputs[:, None])
        self.hidden_biases += back

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
