"""Fields of dataclasses that declare which values they allow, and in which unit.

Example:
  A class with two fields, and a value that is refused:

    @dataclasses.dataclass(frozen=True)
    class Settings(Checked):
        speed: float = number(0.2, 0, 10, "(]", unit="m/s")
        steps: int = whole(1, 1, 1000)

    Settings(speed=0)  # speed must be a number in (0, 10] m/s, got 0

A field's metadata has the rule `allows(value)`, and the `words` that describe the allowed values.
"""

from __future__ import annotations

import dataclasses
import re
import reprlib
import sys
from collections.abc import Callable
from typing import Any, get_args


def field(default: Any, allows: Callable[[Any], bool], words: str, unit: str = "") -> Any:
    """Returns a dataclass field with a rule for its values.

    Args:
      default: Default value; if it is None, the field also accepts None.
      allows: Returns whether a value is allowed.
      words: Description of the allowed values, such as "a number in [0, 1]".
      unit: Unit of the value, such as "m/s"; "" for none.
    """
    optional = default is None
    words = " ".join(filter(None, [words, unit, "or none" if optional else ""]))
    notes = {"allows": allows, "optional": optional, "words": words}
    return dataclasses.field(default=default, metadata=notes)


def flag(default: bool) -> Any:
    """Returns a dataclass field that is true or false."""
    return field(default, lambda value: type(value) is bool, "true or false")


def choice(default: str | None, literal: Any) -> Any:
    """Returns a dataclass field that is one of the strings of a `Literal`."""
    options = get_args(literal)

    def allows(value: Any) -> bool:
        return type(value) is str and value in options

    return field(default, allows, " or ".join(map(repr, options)))


def text(default: str | None, pattern: str, words: str) -> Any:
    """Returns a dataclass field of strings that match a pattern, which `words` describe."""

    def allows(value: Any) -> bool:
        return type(value) is str and re.fullmatch(pattern, value) is not None

    return field(default, allows, words)


def whole(default: int | None, low: int, high: int, unit: str = "") -> Any:
    """Returns a dataclass field of a whole number from `low` to `high`."""

    def allows(value: Any) -> bool:
        return type(value) is int and low <= value <= high

    return field(default, allows, f"a whole number from {low} to {high}", unit)


def number(default: float | None, low: float, high: float, ends: str = "[]", unit: str = "") -> Any:
    """Returns a dataclass field of a number from `low` to `high`.

    Args:
      default: Default value; if it is None, the field also accepts None.
      low: Lower end of the range, itself allowed unless `ends` excludes it.
      high: Upper end of the range, itself allowed unless `ends` excludes it.
      ends: Brackets of the range, such as "(]"; a round bracket excludes its end.
      unit: Unit of the value, such as "m/s"; "" for none.
    """
    return field(default, *_in_range(low, high, ends), unit)


def numbers(default: tuple[float, ...] | None, low: float, high: float, most: int) -> Any:
    """Returns a dataclass field of a tuple of 1 to `most` numbers from `low` to `high`."""
    each, words = _in_range(low, high, "[]")

    def allows(value: Any) -> bool:
        return type(value) is tuple and 1 <= len(value) <= most and all(map(each, value))

    return field(default, allows, f"1 to {most} values, each {words}")


def _in_range(low: float, high: float, ends: str) -> tuple[Callable[[Any], bool], str]:
    """Returns the rule for a number in a range, and its words."""

    def allows(value: Any) -> bool:
        if type(value) not in (int, float) or not low <= value <= high:
            return False
        return not (value == low and ends[0] == "(" or value == high and ends[1] == ")")

    return allows, f"a number in {ends[0]}{low:g}, {high:g}{ends[1]}"


class Checked:
    """Base class of frozen dataclasses: checks the declared fields of every new instance."""

    def __post_init__(self) -> None:
        """Raises ValueError where a value is not allowed."""
        check(self)


def check(instance: Any) -> None:
    """Checks all declared fields of a dataclass instance; NumPy scalars become Python numbers.

    Raises:
      ValueError: A value is not allowed, for example
        "epsilon must be a number in [0, 1], got 2".
    """
    for one in dataclasses.fields(instance):
        if "allows" in (notes := one.metadata):
            value = _plain(getattr(instance, one.name))
            if not (notes["allows"](value) or value is None and notes["optional"]):
                raise ValueError(f"{one.name} must be {notes['words']}, got {shown(value)}")
            object.__setattr__(instance, one.name, value)


def _plain(value: Any) -> Any:
    if isinstance(value, tuple):
        return tuple(map(_plain, value))
    numpy = sys.modules.get("numpy")  # a NumPy scalar exists only if NumPy is loaded
    return value.item() if numpy is not None and isinstance(value, numpy.generic) else value


class _Short(reprlib.Repr):
    """A `repr` that reads only the beginning of a value."""

    def __init__(self) -> None:
        super().__init__()
        self.maxlevel = 2

    def repr_int(self, x: int, level: int) -> str:
        return repr(x) if x.bit_length() < 2000 else "a number of too many digits"

    def repr_instance(self, x: Any, level: int) -> str:
        if isinstance(x, str | bytes | bytearray):
            return repr(x[:100])
        small = x is None or isinstance(x, bool | float | complex)
        return repr(x) if small else f"an object of type {type(x).__name__}"

    repr_str = repr_instance


def shown(value: Any) -> str:
    """Returns a value as text for an error, shortened to 60 characters."""
    brief = _Short().repr(value)
    return brief if len(brief) <= 60 else f"{brief[:57]}..."
