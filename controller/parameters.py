"""Every number of the brain, in one frozen dataclass that names its place in the paper."""

from __future__ import annotations

import dataclasses
import math
from typing import Literal

Proposer = Literal["fixed", "random", "creative"]
PROPOSERS: tuple[Proposer, ...] = ("fixed", "random", "creative")


@dataclasses.dataclass(frozen=True)
class Parameters:
    """The brain's parameters; the defaults are the paper's.

    Attributes:
      evaluation_hidden: logistic hidden neurons of the evaluation network (section 3).
      learn_rate: eta of Eq. 1 (section 3).
      discount: gamma of Eq. 1 (section 3).
      epsilon: probability of a random action among those proposed, while learning (section 3).
      test_epsilon: the same in the test phases (not stated: docs/paper.md).
      fixed_motors: the motor values whose pairs are the fixed actions (section 3).
      ideas: actions that the random and the creative proposer offer a step (section 3).
      memory_hidden: logistic hidden neurons of the creative memory (section 3).
      noise: sigma, added to or subtracted from each noisy connection (section 3).
      noisy_share: share of the connections that are noisy in an idea, "a quarter" (section
        3); their number is rounded to the nearest.
      noise_on_biases: whether biases count as connections (not stated).
      keep_main_idea: whether the first idea is the memory's own, without noise (not stated).
      initial_range: weights and biases are drawn from [-initial_range, initial_range]
        (section 3.1).
    """

    evaluation_hidden: int = 7
    learn_rate: float = 0.01
    discount: float = 0.9
    epsilon: float = 0.01
    test_epsilon: float = 0.0
    fixed_motors: tuple[float, ...] = (-0.5, -0.25, 0.0, 0.25, 0.5)
    ideas: int = 25
    memory_hidden: int = 5
    noise: float = 0.76
    noisy_share: float = 0.25
    noise_on_biases: bool = False
    keep_main_idea: bool = False
    initial_range: float = 1.0

    def __post_init__(self) -> None:
        """Raises ValueError, naming the field, where a number makes no sense."""
        for name in ("evaluation_hidden", "ideas", "memory_hidden"):
            if getattr(self, name) < 1:
                raise ValueError(f"{name} must be at least 1, got {getattr(self, name)}")
        for name in ("discount", "epsilon", "test_epsilon", "noisy_share"):
            if not 0 <= getattr(self, name) <= 1:
                raise ValueError(f"{name} must lie in [0, 1], got {getattr(self, name)}")
        for name in ("learn_rate", "noise", "initial_range"):
            if not 0 <= getattr(self, name) < math.inf:
                raise ValueError(f"{name} must not be negative, got {getattr(self, name)}")
        if not self.fixed_motors or not all(abs(m) <= 0.5 for m in self.fixed_motors):
            raise ValueError(f"fixed_motors must lie in [-0.5, 0.5], got {self.fixed_motors}")
