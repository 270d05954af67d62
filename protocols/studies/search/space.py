"""The space that is searched: each parameter of a brain as a coordinate in [0, 1]."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping, Sequence
from types import MappingProxyType

import numpy as np

from ....controller import Parameters
from ...errors import InputError, nearest


@dataclasses.dataclass(frozen=True)
class Range:
    """The range in which a parameter is searched.

    Attributes:
      low: Value at coordinate 0.
      high: Value at coordinate 1.
      log: Whether equal steps of the coordinate are equal factors of the value.
      decay: Whether they are equal factors of 1 minus the value, so of a decay's time constant.
      whole: Whether the value is rounded to a whole number.
    """

    low: float
    high: float
    log: bool = False
    decay: bool = False
    whole: bool = False

    def value(self, coordinate: float) -> float:
        """Returns the value at a coordinate; outside [0, 1] it is the nearer end's."""
        share = min(max(coordinate, 0.0), 1.0)
        if self.log:
            found = self.low * (self.high / self.low) ** share
        elif self.decay:
            found = 1 - (1 - self.low) * ((1 - self.high) / (1 - self.low)) ** share
        else:
            found = self.low + share * (self.high - self.low)
        return round(found) if self.whole else float(f"{found:.6g}")  # as a person would write it

    def coordinate(self, value: float) -> float:
        """Returns the coordinate of a value, in [0, 1]."""
        value = min(max(value, self.low), self.high)
        if self.log:
            return math.log(value / self.low) / math.log(self.high / self.low)
        if self.decay:
            return math.log((1 - value) / (1 - self.low)) / math.log(
                (1 - self.high) / (1 - self.low)
            )
        return (value - self.low) / (self.high - self.low)


# Wide ranges around the values of `paper` and `steady`.
RANGES: Mapping[str, Range] = MappingProxyType(
    {
        "learn_rate": Range(1e-5, 0.1, log=True),
        "initial_learn_rate": Range(1e-5, 0.1, log=True),
        "learn_rate_decay_steps": Range(1e3, 1e6, log=True),
        "discount": Range(0.5, 0.99, decay=True),
        "epsilon": Range(0.001, 0.5, log=True),
        "initial_epsilon": Range(0.001, 1.0, log=True),
        "epsilon_decay_steps": Range(1e3, 1e6, log=True),
        "exploration_steps": Range(1, 60, log=True, whole=True),
        "noise": Range(0.0, 2.0),
        "noisy_share": Range(0.05, 1.0),
        "random_share": Range(0.0, 0.9),
        "advantage_scale": Range(0.0, 1.5),
        "initial_range": Range(0.05, 2.0, log=True),
        "evaluation_hidden": Range(3, 48, log=True, whole=True),
        "memory_hidden": Range(2, 32, log=True, whole=True),
        "td_error_limit": Range(0.003, 10.0, log=True),
        "reward_decay": Range(0.0, 0.999, decay=True),
    }
)


NEWBORNS = frozenset({"initial_range", "evaluation_hidden", "memory_hidden"})
"""Parameters on which a newborn's networks depend."""


def check_names(names: Sequence[str], brain: Parameters) -> None:
    """Raises InputError if a parameter cannot be searched, in its whole range, with the brain."""
    if not names:
        raise InputError(f"over needs at least one of {', '.join(RANGES)}")
    for name in names:
        if name not in RANGES:
            raise InputError(
                f"there is no parameter {name!r:.60} to search: {nearest(name, RANGES)}"
            )
        if (value := getattr(brain, name)) is None:
            raise InputError(f"the brain has no {name}: give it a value first, by --set")
        if not RANGES[name].low <= value <= RANGES[name].high:
            low, high = RANGES[name].low, RANGES[name].high
            raise InputError(
                f"{name} is searched from {low:g} to {high:g}, but the search would start at "
                f"{value:g}: give it another value by --set"
            )
        first = f"initial_{name.removesuffix('_decay_steps')}"
        if name.endswith("_decay_steps") and getattr(brain, first) is None:
            raise InputError(f"{name} has no effect without {first}: give it a value by --set")
    if len({*names}) < len(names):
        raise InputError(f"the parameters must differ, got {', '.join(names)}")
    for name in names:
        for end in (0.0, 1.0):
            try:
                brain_at(np.array([end]), [name], brain)
            except ValueError as error:
                value = RANGES[name].value(end)
                raise InputError(f"{name} cannot be evolved: at {value:g}, {error}") from error


def point_of(brain: Parameters, names: Sequence[str]) -> np.ndarray:
    """Returns the coordinates of a brain's parameters, each in [0, 1], shape (n,)."""
    return np.array([RANGES[name].coordinate(getattr(brain, name)) for name in names])


def brain_at(point: np.ndarray, names: Sequence[str], brain: Parameters) -> Parameters:
    """Returns a brain with the parameters of a point.

    Args:
      point: A coordinate of each parameter, shape (n,).
      names: Names of the parameters.
      brain: Brain with all other parameters.
    """
    values = {name: RANGES[name].value(float(x)) for name, x in zip(names, point, strict=True)}
    return dataclasses.replace(brain, **values)
