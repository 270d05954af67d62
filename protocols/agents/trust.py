"""Which users' agents may run: those that the command names, never those named by a file alone."""

from __future__ import annotations

import sys
from pathlib import Path

from ..errors import InputError
from .names import is_own

# Factories of users whose code may run here: named by this command, never by a file alone.
_TRUSTED: set[str] = set()


def trust(*names: str) -> None:
    """Lets `make_agent` import the factories that the user's command names.

    Their modules are also looked for in the working directory, as with `python -m`.
    """
    own = [name for name in names if not is_own(name)]
    _TRUSTED.update(own)
    here = str(Path.cwd()) if own else ""
    if here and here not in sys.path:
        sys.path.insert(0, here)


def check_trusted(name: str, source: object) -> None:
    """Raises InputError where a proposer is a user's factory that the command has not named.

    Args:
      name: Name of a proposer or factory.
      source: What names it.
    """
    if not is_own(name) and name not in _TRUSTED:
        raise InputError(
            f"{source} names the agent {name}, whose code would be run: allow it by --agent "
            f"{name}, or in `musebot run` by --trust-agent"
        )
