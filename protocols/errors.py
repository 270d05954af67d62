"""Errors whose text is one sentence, and functions that suggest remedies."""

from __future__ import annotations

import difflib
from collections.abc import Iterable

_MOST_LISTED = 20  # names in a sentence


class InputError(Exception):
    """The user's request cannot be carried out; the text says why."""


class DamagedFileError(InputError):
    """A file is truncated, altered or not one of musebot's; the text names it."""


class RunError(Exception):
    """A simulation could not continue; the text says why."""


class Interrupted(Exception):
    """A simulation was asked to stop; everything simulated so far is in its checkpoints."""


def check_name(what: str, name: object, known: Iterable[str]) -> None:
    """Raises InputError unless `name` is in `known`; `what` is the kind of name, as "task"."""
    names = [*known]
    if name not in names:
        raise InputError(f"there is no {what} {name!r:.60}; {nearest(str(name), names)}")


def nearest(name: str, known: Iterable[str]) -> str:
    """Returns "did you mean ...?" with similar names, or, without any, a list of the names."""
    names = [*known]
    if question := similar(name, names):
        return question
    more = f" and {len(names) - _MOST_LISTED} more" if len(names) > _MOST_LISTED else ""
    return f"there are {', '.join(names[:_MOST_LISTED])}{more}" if names else "there are none"


def similar(name: str, known: Iterable[str]) -> str:
    """Returns "did you mean ...?" with at most three similar names; "" if no name is similar.

    Names that begin with the given one come first. Leading dashes are not compared: they would
    make all options similar.
    """
    name = name.lstrip("-")

    def likeness(other: str) -> float:
        other = other.lstrip("-")
        begins = bool(name) and other.startswith(name)
        return max(0.95 * begins, difflib.SequenceMatcher(None, other, name).ratio())

    ratios = sorted(((likeness(other), other) for other in known), key=lambda pair: -pair[0])
    near = [other for ratio, other in ratios if ratio >= max(0.6, ratios[0][0] - 0.1)]
    return f"did you mean {' or '.join(near[:3])}?" if near else ""
