"""The arms of the study: what of an old brain is kept when the body changes."""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Mapping
from types import MappingProxyType

import numpy as np

from ....controller.noise import NoisePatterns
from ....controller.parameters import Parameters

# Each factor and its levels; the first level is that of the old brain.
FACTORS: Mapping[str, tuple[str, str]] = MappingProxyType(
    {
        "memory": ("trained", "born"),
        "noise": ("noise", "quiet"),
        "ideas": ("random", "own"),
        "clock": ("old", "reset"),
    }
)
NEWBORN, FROZEN = "newborn", "frozen"


@dataclasses.dataclass(frozen=True)
class Arm:
    """An arm: a level of each factor, or a control.

    Attributes:
      name: Name, such as "trained-noise-random-old"; of a control "newborn" or "frozen".
      levels: Level of each factor, by factor; empty for a control.
    """

    name: str
    levels: Mapping[str, str] = dataclasses.field(default_factory=dict, compare=False)

    def with_level(self, factor: str, level: str) -> str:
        """Returns the name of the arm that differs in one factor's level."""
        return "-".join({**self.levels, factor: level}.values())

    def brain(self, old: Parameters) -> Parameters:
        """Returns the parameters of the arm's brain.

        Args:
          old: Parameters of the old brain; its noise and its share of random ideas are those of
            the levels "noise" and "random".
        """
        noise = 0.0 if self.levels.get("noise") == "quiet" else old.noise
        share = 0.0 if self.levels.get("ideas") == "own" else old.random_share
        return dataclasses.replace(old, noise=noise, random_share=share)

    def state(
        self, old: Mapping[str, np.ndarray], born: Mapping[str, np.ndarray]
    ) -> dict[str, np.ndarray]:
        """Returns the state with which the arm's brain continues.

        Args:
          old: State of the old brain, see `Agent.state`.
          born: Networks of the same brain at birth, see `Agent.weights`.
        """
        state = {name: array.copy() for name, array in old.items()}
        if self.levels.get("clock") == "reset":
            state["age"][...] = 0
        if self.levels.get("noise") == "quiet":
            state["noise.age"][...] = NoisePatterns.LIFETIME  # patterns are drawn anew
        if self.levels.get("memory") == "born":
            for name, array in state.items():
                if name.startswith("memory."):
                    array[...] = born.get(name, 0)  # the optimizer begins at 0
        return state


def _arms() -> dict[str, Arm]:
    crossed = [dict(zip(FACTORS, row, strict=True)) for row in itertools.product(*FACTORS.values())]
    arms = [Arm("-".join(levels.values()), MappingProxyType(levels)) for levels in crossed]
    return {arm.name: arm for arm in [*arms, Arm(NEWBORN), Arm(FROZEN)]}


ARMS: Mapping[str, Arm] = MappingProxyType(_arms())


def learns(name: str) -> bool:
    """Returns whether robots of an arm can learn.

    Frozen ones cannot, nor those whose only idea is a memory's without noise: they always do what
    the memory says, and it has nothing else to learn.
    """
    return name != FROZEN and "quiet-own" not in name


def pairs(factor: str, names: Mapping[str, object]) -> list[tuple[str, str]]:
    """Returns the pairs of arms that differ in a factor alone.

    Args:
      factor: Factor of `FACTORS`.
      names: Names of the arms that there are.

    Returns:
      Pairs of names: the arm with the first level, and the arm with the second.
    """
    first, second = FACTORS[factor]
    found = []
    for name, arm in ARMS.items():
        if name in names and arm.levels.get(factor) == first:
            if (other := arm.with_level(factor, second)) in names:
                found.append((name, other))
    return found
