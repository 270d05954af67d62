"""Settings of agents: numbers that a factory receives as keywords, each with its range."""

from __future__ import annotations

import dataclasses
import functools
import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any, TypeVar

import numpy as np

from ...fields import shown
from ..errors import InputError, nearest

_SETTINGS = "agent_settings"
Number = float | np.ndarray  # one for all robots, or one for each, shape (B,)
Factory = TypeVar("Factory", bound=Callable[..., Any])


@dataclasses.dataclass(frozen=True)
class Setting:
    """A number that a user may choose.

    Attributes:
      default: Value if no other is chosen; if it is an int, only whole numbers are allowed.
      low: Smallest allowed value.
      high: Largest allowed value.
      says: Meaning of the setting in a few words.
      log: Whether tuning draws the logarithm of the value uniformly, instead of the value.
      tuned: Whether `musebot benchmark tune` changes it.
      each: Whether robots of a cohort may have different values. If they do, the factory receives
        an array of shape (B,), int64 for whole numbers, else float64. If all tuned settings allow
        different values, tuning simulates several trials together, which takes less time.
    """

    default: float
    low: float
    high: float
    says: str = ""
    log: bool = False
    tuned: bool = True
    each: bool = False

    def __post_init__(self) -> None:
        """Raises ValueError if the default or the range is invalid."""
        if type(self.default) is bool:
            raise ValueError("a setting is a number; take 0 and 1 for no and yes")
        most = 2**53 if self.whole else 1e300
        if not -most <= self.low <= self.high <= most:
            raise ValueError(f"a range must be ordered and finite, got [{self.low}, {self.high}]")
        if self.whole and (self.low % 1 or self.high % 1):
            raise ValueError(f"a whole number's range must be, too, got [{self.low}, {self.high}]")
        if self.log and not self.low > 0:
            raise ValueError(f"a logarithmic range must be above 0, got {self.low}")
        if not self.low <= self.default <= self.high:
            raise ValueError(f"{self.default} does not lie in [{self.low}, {self.high}]")

    @property
    def whole(self) -> bool:
        """Whether the value is a whole number."""
        return type(self.default) is int

    def allows(self, value: float) -> bool:
        """Returns whether a value lies in the range, and is whole where it must be."""
        return self.low <= value <= self.high and (not self.whole or value == int(value))

    def at(self, share: float) -> float:
        """Returns the value at a share of the range, from 0 (lowest) to 1 (highest)."""
        # Each whole number has an equal part of the range.
        low, high = (self.low - 0.5, self.high + 0.5) if self.whole else (self.low, self.high)
        value = low * (high / low) ** share if self.log else low + share * (high - low)
        rounded = round(value) if self.whole else float(f"{value:.3g}")
        return type(self.default)(min(max(rounded, self.low), self.high))


def tunable(**settings: Setting) -> Callable[[Factory], Factory]:
    """Declares a factory's settings; it receives each as a keyword, with its default or as set."""

    def decorate(factory: Factory) -> Factory:
        @functools.wraps(factory, updated=())  # a class has a large `__dict__`
        def complete(*arguments: Any, **chosen: float) -> Any:
            defaults = {name: setting.default for name, setting in settings.items()}
            return factory(*arguments, **defaults | chosen)

        setattr(complete, _SETTINGS, settings)
        return complete  # type: ignore[return-value]

    return decorate


def settings_of(factory: Callable[..., Any]) -> Mapping[str, Setting]:
    """Returns the settings of a factory, by name; empty if it has none."""
    return getattr(factory, _SETTINGS, {})


def settings_from(words: Sequence[str], several: bool = False) -> dict[str, list[float]]:
    """Reads settings of the form NAME=VALUE; returns the values of each by name.

    Args:
      words: Settings, each as NAME=VALUE, such as "rate=0.1".
      several: Whether VALUE may be several numbers, separated by commas, each for an equal share
        of a cohort's robots.

    Raises:
      InputError: a word has another form, a value is no finite number, or a name occurs twice.
    """
    settings: dict[str, list[float]] = {}
    for word in words:
        name, _, text = word.partition("=")
        try:
            values = [float(one) for one in (text.split(",") if several else [text])]
        except ValueError:
            values = [math.nan]
        if not name.isidentifier() or not all(map(math.isfinite, values)):
            raise InputError(f"a setting must be NAME=VALUE with a number, got {shown(word)}")
        if name in settings:
            raise InputError(f"the setting {name} is given twice")
        settings[name] = values
    return settings


def checked_settings(
    agent: str, factory: Callable[..., Any], settings: Mapping[str, Sequence[float]], robots: int
) -> dict[str, Number]:
    """Checks settings, and returns them as keyword arguments of a factory.

    If a setting has several values, each is for an equal share of the B robots.

    Raises:
      InputError: the agent has no such setting, a value is out of range, or the robots cannot have
        this number of values.
    """
    known = settings_of(factory)
    checked: dict[str, Number] = {}
    for name, values in settings.items():
        if name not in known:
            raise InputError(f"{agent} has no setting {name}: {nearest(name, known)}")
        setting = known[name]
        for value in values:
            if not setting.allows(value):
                kind = "be a whole number" if setting.whole else "lie"
                raise InputError(
                    f"the setting {name} of {agent} must {kind} in "
                    f"[{setting.low:g}, {setting.high:g}], got {shown(value)}"
                )
        if len(values) > 1 and (not setting.each or robots % len(values)):
            raise InputError(f"{robots} robots cannot have {len(values)} values of {name}")
        kind = np.int64 if setting.whole else np.float64
        array = np.array(values, kind)
        checked[name] = array[0].item() if len(values) == 1 else array.repeat(robots // len(values))
    return checked
