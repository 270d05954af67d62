"""Hidden neurons that receive either the smell or the other signals."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor


def separated(hidden: int, state: int, smell: Sequence[int], inputs: int) -> Tensor | None:
    """Returns which hidden neurons receive which inputs: 1 or 0, shape (H, I).

    Args:
      hidden: Number H of hidden neurons; the first half of them receives the smell.
      state: Number of inputs for the state, which come first; all neurons receive the others.
      smell: Indices of the inputs that are the smell.
      inputs: Number I of inputs.

    Returns:
      The connections; None where the smell is no input, or the only one.
    """
    others = [number for number in range(state) if number not in smell]
    if not smell or not others:
        return None
    connected = torch.ones(hidden, inputs)
    connected[: hidden // 2, others] = 0
    connected[hidden // 2 :, list(smell)] = 0
    return connected
