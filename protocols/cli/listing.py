"""`musebot list`: what the other commands take by name."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping
from typing import Annotated, Any

import tyro

from ..compare import STUDIES
from ..errors import InputError
from ..terminal import say

# A line for each of what the code does not describe in a docstring; a test compares the names.
_PROTOCOLS = {
    "paper": "The paper's lives: two hours of wall avoidance, four hours of spot finding.",
    "walls": "Spot finding in which the robot also senses walls.",
}
_BRAINS = {
    "paper": "The paper's brain.",
    "steady": "Two larger networks with other inputs and another learning rule.",
    "recurrent": "Steady with a recurrent context: units that remember what was sensed.",
}
_PROPOSERS = {
    "fixed": "Proposer of a brain: always the same actions.",
    "random": "Proposer of a brain: new random actions in each step.",
    "creative": "Proposer of a brain: ideas of its creative memory.",
}


@dataclasses.dataclass
class ListCommand:
    """List tasks, brains, protocols, studies and agents by name, a line each."""

    kind: Annotated[
        str, tyro.conf.Positional, tyro.conf.arg(metavar="[KIND]", help_behavior_hint="")
    ] = ""
    """tasks, brains, protocols, studies or agents; without it, all of them"""

    def __call__(self) -> None:
        """Prints the lists.

        Raises:
          InputError: there is no such kind.
        """
        if self.kind and self.kind not in LISTS:
            raise InputError(f"the list must be one of {', '.join(LISTS)}, got {self.kind!r}")
        for kind in [self.kind] if self.kind else LISTS:
            if not self.kind:
                say(f"{kind}:")
            lines = LISTS[kind]()
            width = max(map(len, lines))
            for name, line in lines.items():
                say(f"{'' if self.kind else '  '}{name:{width}}  {line}")


def tasks() -> dict[str, str]:
    """Returns a line for each task of the domain "arena"."""
    from ...tasks.suite import SUITE, TASKS

    lines = {name: _first_line(SUITE[name]).removeprefix("Returns ") for name in TASKS}
    return {name: line[:1].upper() + line[1:] for name, line in lines.items()}


def brains() -> dict[str, str]:
    """Returns a line for each named brain."""
    from ...controller.brains import BRAINS, INGREDIENTS

    less = {f"steady-{one}": f"`steady` without its ingredient {one}." for one in INGREDIENTS}
    lines = _BRAINS | less
    return {name: lines[name] for name in BRAINS}


def protocols() -> dict[str, str]:
    """Returns a line for each protocol."""
    return _PROTOCOLS


def studies() -> dict[str, str]:
    """Returns a line for each study."""
    return {name: line for name, (_, _, line) in STUDIES.items()}


def agents() -> dict[str, str]:
    """Returns a line for each proposer, for `--proposer`, and for each agent, for `--agent`."""
    from ..agents.factory import factory_of
    from ..agents.names import RECORDED_NAMES, registered_names

    own = {name: _first_line(factory_of(name)) for name in RECORDED_NAMES}
    others = {name: f"Another package's: {value}." for name, value in registered_names().items()}
    return _PROPOSERS | own | others


LISTS: Mapping[str, Callable[[], dict[str, str]]] = {
    one.__name__: one for one in (tasks, brains, protocols, studies, agents)
}


def _first_line(described: Any) -> str:
    return (described.__doc__ or "").partition("\n")[0]
