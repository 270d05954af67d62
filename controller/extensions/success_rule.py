"""A rule that sets the noise of the creative memory by the success of its ideas."""

from __future__ import annotations

import torch
from torch import Tensor


class SuccessRule:
    """The one-fifth success rule: the noise grows where many ideas are better than the main idea.

    In each step of training, a robot's noise is multiplied by exp(rate * (p - `TARGET`)), where p
    is the share of its ideas whose value exceeds that of the main idea. The evaluation network's
    own values decide, so no further action is evaluated.

    Source: Rechenberg, Evolutionsstrategie (1973): mutations should be larger if more than one in
    five is successful; a smooth form with one rate is in Kern et al., Natural Computing 3 (2004).
    The bounds of the noise are ours: where the best action is in a corner, larger noise is always
    better, and only the bound ends the growth.

    Attributes:
      scale: Noise of each robot, as a factor of `Parameters.noise`, shape (B, 1).
    """

    TARGET = 0.2
    SMALLEST, LARGEST = 0.01, 10.0

    def __init__(self, robots: int, rate: float) -> None:
        """Takes the number B of robots, and the rate of the adaptation per control step."""
        self._rate = rate
        self.scale = torch.ones(robots, 1)

    def update(self, values: Tensor) -> None:
        """Adapts the noise.

        Args:
          values: Values of a robot's ideas, the main idea's first, shape (B, A), A at least 2.
        """
        success = (values[:, 1:] > values[:, :1]).to(self.scale.dtype).mean(1, keepdim=True)
        self.scale *= (self._rate * (success - self.TARGET)).exp()
        self.scale.clamp_(self.SMALLEST, self.LARGEST)
