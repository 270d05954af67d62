"""Fields of a command: its options, and its words without an option."""

from __future__ import annotations

import dataclasses
from typing import Any


def option(
    default: Any, says: str, values: str = "", *, choices: tuple[str, ...] = (), group: str = ""
) -> Any:
    """Returns the field of an option, such as `--robots`.

    Args:
      default: Value if it is not given; `dataclasses.MISSING` if it must be given.
      says: Meaning, with unit and default.
      values: Values as help shows them; "" for the choices.
      choices: Values that are allowed; empty if what uses the value checks it.
      group: Heading under which help lists it; "" for "options".
    """
    values = values or f"{{{','.join(choices)}}}"
    notes = {"says": says, "values": values, "choices": choices, "group": group, "option": True}
    return dataclasses.field(default=default, metadata=notes)


def argument(says: str, values: str, default: Any = dataclasses.MISSING) -> Any:
    """Returns the field of a word without an option, such as OUT."""
    notes = {"says": says, "values": values, "choices": (), "group": "", "option": False}
    return dataclasses.field(default=default, metadata=notes)
