"""Fields of dataclasses that declare which values they allow, in which unit, and why.

Example:
  A class with two fields, and a value that is refused:

    @dataclasses.dataclass(frozen=True)
    class Settings(Checked):
        speed: float = number(0.2, 0, 10, "(]", unit="m/s")
        steps: int = whole(1, 1, 1000, reason="more take hours")

    Settings(speed=0)  # speed must be a number in (0, 10] m/s, got 0

The allowed values of a field are a container (`value in allowed`); its `str` describes them.
"""

from __future__ import annotations

import dataclasses
import re
import reprlib
import sys
from collections.abc import Container
from typing import Any, get_args


@dataclasses.dataclass(frozen=True)
class Flag:
    """The values True and False."""

    def __contains__(self, value: Any) -> bool:
        return type(value) is bool

    def __str__(self) -> str:
        return "true or false"


@dataclasses.dataclass(frozen=True)
class Choice:
    """The strings in `options`."""

    options: tuple[str, ...]

    def __contains__(self, value: Any) -> bool:
        return type(value) is str and value in self.options

    def __str__(self) -> str:
        return " or ".join(map(repr, self.options))


@dataclasses.dataclass(frozen=True)
class Text:
    """Strings that match the regular expression `pattern` as a whole; `words` describes them."""

    pattern: str
    words: str

    def __contains__(self, value: Any) -> bool:
        return type(value) is str and re.fullmatch(self.pattern, value) is not None

    def __str__(self) -> str:
        return self.words


@dataclasses.dataclass(frozen=True)
class Whole:
    """Whole numbers from `low` to `high`."""

    low: int
    high: int

    def __contains__(self, value: Any) -> bool:
        return type(value) is int and self.low <= value <= self.high

    def __str__(self) -> str:
        return f"a whole number from {self.low} to {self.high}"


@dataclasses.dataclass(frozen=True)
class Number:
    """Numbers from `low` to `high`; "(" or ")" in `ends` excludes an end."""

    low: float
    high: float
    ends: str = "[]"

    def __contains__(self, value: Any) -> bool:
        if type(value) not in (int, float) or not self.low <= value <= self.high:
            return False
        below = value == self.low and self.ends[0] == "("
        above = value == self.high and self.ends[1] == ")"
        return not (below or above)

    def __str__(self) -> str:
        return f"a number in {self.ends[0]}{self.low:g}, {self.high:g}{self.ends[1]}"


@dataclasses.dataclass(frozen=True)
class Several:
    """Tuples of 1 to `most` values, each of them in the container `each`."""

    each: Container[Any]
    most: int

    def __contains__(self, value: Any) -> bool:
        if type(value) is not tuple or not 1 <= len(value) <= self.most:
            return False
        return all(one in self.each for one in value)

    def __str__(self) -> str:
        return f"1 to {self.most} values, each {self.each}"


def field(default: Any, allowed: Container[Any], unit: str = "", reason: str = "") -> Any:
    """Returns a dataclass field that allows the values in `allowed`; see `whole` and `number`.

    Args:
      default: Default value; if it is None, the field also accepts None.
      allowed: Container of the allowed values, such as `Number(0, 1)`; its `str` describes them.
      unit: Unit of the value, such as "m/s"; "" for none.
      reason: Reason for the range, kept in the field's metadata; "" if it is obvious.
    """
    notes = {"allowed": allowed, "optional": default is None, "unit": unit, "reason": reason}
    return dataclasses.field(default=default, metadata=notes)


def flag(default: bool | None, **notes: str) -> Any:
    """Returns a dataclass field that is true or false; `notes`: unit and reason, see `field`."""
    return field(default, Flag(), **notes)


def choice(default: str | None, literal: Any, **notes: str) -> Any:
    """Returns a dataclass field that is one of the strings of a `Literal`."""
    return field(default, Choice(get_args(literal)), **notes)


def text(default: str | None, pattern: str, words: str, **notes: str) -> Any:
    """Returns a dataclass field of strings that match a pattern, which `words` describe."""
    return field(default, Text(pattern, words), **notes)


def whole(default: int | None, low: int, high: int, **notes: str) -> Any:
    """Returns a dataclass field of a whole number from `low` to `high`."""
    return field(default, Whole(low, high), **notes)


def number(default: float | None, low: float, high: float, ends: str = "[]", **notes: str) -> Any:
    """Returns a dataclass field of a number from `low` to `high`.

    Args:
      default: Default value; if it is None, the field also accepts None.
      low: Lower end of the range, itself allowed unless `ends` excludes it.
      high: Upper end of the range, itself allowed unless `ends` excludes it.
      ends: Brackets of the range, such as "(]"; a round bracket excludes its end.
      **notes: `unit` and `reason`, as for `field`.
    """
    return field(default, Number(low, high, ends), **notes)


def numbers(
    default: tuple[float, ...] | None, low: float, high: float, most: int, **notes: str
) -> Any:
    """Returns a dataclass field of a tuple of 1 to `most` numbers from `low` to `high`."""
    return field(default, Several(Number(low, high), most), **notes)


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
        if "allowed" in one.metadata:
            value = checked(one, getattr(instance, one.name))
            object.__setattr__(instance, one.name, value)


def checked(one: dataclasses.Field[Any], value: Any) -> Any:
    """Returns a declared field's value if it is allowed; NumPy scalars become Python numbers.

    Raises:
      ValueError: The value is not allowed.
    """
    value = _plain(value)
    if value is None and one.metadata["optional"]:
        return None
    if value not in one.metadata["allowed"]:
        raise ValueError(f"{one.name} must be {described(one)}, got {shown(value)}")
    return value


def _plain(value: Any) -> Any:
    if isinstance(value, tuple):
        return tuple(map(_plain, value))
    numpy = sys.modules.get("numpy")  # a NumPy scalar exists only if NumPy is loaded
    return value.item() if numpy is not None and isinstance(value, numpy.generic) else value


def described(one: dataclasses.Field[Any]) -> str:
    """Describes the values that a field allows, such as "a number in (0, 10] m/s or none"."""
    notes = one.metadata
    words = [str(notes["allowed"]), notes["unit"], "or none" if notes["optional"] else ""]
    return " ".join(filter(None, words))


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
