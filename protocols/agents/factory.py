"""Finds factories of agents by name, and decides which users' factories may run.

A factory, named `package.module:factory`, receives the number of robots, their `Senses` (ranges of
signals and reward) and a seed; the run's settings follow as keywords. It returns an `Agent`.
"""

from __future__ import annotations

import importlib
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any, cast

from ..errors import InputError, similar
from .base import Agent
from .checked_agent import ending_in_a_sentence
from .names import FACTORIES, RECORDED_NAMES, is_own

# Users' factories whose code may run: those that the command names, not a file alone.
_TRUSTED: set[str] = set()


def trust(*names: str) -> None:
    """Lets `factory_of` import the factories that the user's command names.

    Their modules are also looked for in the working directory, after Python's and all installed
    ones: a user's file may have the name of one that others import.
    """
    own = [name for name in names if not is_own(name)]
    _TRUSTED.update(own)
    here = str(Path.cwd()) if own else ""
    if here and here not in sys.path:
        sys.path.append(here)


def check_trusted(name: str, source: object) -> None:
    """Raises InputError if `source`, such as a file, names a factory that no command names."""
    if not is_own(name) and name not in _TRUSTED:
        raise InputError(
            f"{source} names the agent {name}, whose code would be run: allow it by --agent "
            f"{name}, or in `musebot run` by --trust-agent"
        )


def factory_of(name: str) -> Callable[..., Agent]:
    """Returns the factory of an agent.

    Args:
      name: One of three: a short name, a name that runs record (see `RECORDED_NAMES`), or
        "package.module:factory".

    Raises:
      InputError: the factory is not trusted, is not found, or fails to import.
      RunError: the factory's module exits.
    """
    name = RECORDED_NAMES.get(name, name)
    check_trusted(name, "the experiment")
    module, _, attribute = FACTORIES.get(name, name).partition(":")
    factory: Any
    with ending_in_a_sentence(f"{module} cannot be imported", InputError):
        try:
            found = importlib.import_module(module)
            factory = getattr(found, attribute, None)
        except ModuleNotFoundError as error:
            if not f"{module}.".startswith(f"{error.name}."):
                raise  # it exists, but what it imports does not
            raise InputError(
                f"there is no agent {name}: no module {error.name} in the working directory or "
                "among the installed packages"
            ) from error
    if factory is None:
        names = [name for name, one in vars(found).items() if callable(one) and name[0] != "_"]
        question = similar(attribute, names)
        more = f"; {question}" if question else ""
        raise InputError(f"there is no agent {name}: {module} has no {attribute}{more}")
    if not callable(factory):
        raise InputError(f"{name} must be a factory of agents, got {type(factory).__name__}")
    return cast(Callable[..., Agent], factory)
