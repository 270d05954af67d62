"""Conditions and cohorts: which robots are simulated, ordered as in the paper's tables."""

from __future__ import annotations

import dataclasses
import re

from ...controller.parameters import PROPOSERS
from ...fields import shown
from ...tasks.lives import LIFE_NAME, LIVES
from ..agents.names import OWN
from ..errors import InputError, similar

_LONGEST = 150  # bytes of an agent's name, which is part of files' names
_FACTORY = re.compile(r"[A-Za-z_]\w*(\.[A-Za-z_]\w*)*:[A-Za-z_]\w*")


@dataclasses.dataclass(frozen=True)
class Condition:
    """A column of table 1 or 2: a life, and the proposer or agent of its robots.

    Conditions sort as in the paper's tables; agents come after the paper's proposers, by name.

    Attributes:
      life: Name of a life, such as "spot_finding"; NAME@K is phase K (from 1) of the life NAME,
        with untrained robots.
      proposer: "fixed", "random" or "creative", or the factory of an agent as
        "package.module:factory".
    """

    life: str
    proposer: str

    def __post_init__(self) -> None:
        """Raises InputError if `life` or `proposer` has a wrong form."""
        if not LIFE_NAME.fullmatch(self.life):
            raise InputError(
                f"a life has a name such as {', '.join(LIVES)}, got {shown(self.life)}"
            )
        name = self.proposer
        if name not in PROPOSERS and not _FACTORY.fullmatch(name):
            question = f"--agent {name} takes it" if name in OWN else similar(name, PROPOSERS)
            raise InputError(
                f"the proposer must be one of {', '.join(PROPOSERS)}, or an agent's factory as "
                f"package.module:factory, got {name!r}{question and f'; {question}'}"
            )
        if len(name.encode()) > _LONGEST:
            raise InputError(
                f"an agent's name must have at most {_LONGEST} bytes, got {shown(name)}"
            )

    def __str__(self) -> str:
        """Returns "life/proposer", the name of the condition in files and random streams."""
        return f"{self.life}/{self.proposer}"

    def __lt__(self, other: Condition) -> bool:
        """Compares by the order of the tables."""
        return self._order < other._order

    @property
    def has_brain(self) -> bool:
        """Whether a neurocontroller drives the robots, not another agent."""
        return self.proposer in PROPOSERS

    @property
    def _order(self) -> tuple[int, str, int, str]:
        names, lives = [*PROPOSERS, self.proposer], [*LIVES, self.life]
        return lives.index(self.life), self.life, names.index(self.proposer), self.proposer


@dataclasses.dataclass(frozen=True, order=True)
class CohortKey:
    """The identity of a cohort: its condition, and its number within the condition."""

    condition: Condition
    index: int

    def __str__(self) -> str:
        """Returns the name of the cohort's files."""
        condition = self.condition
        return f"{condition.life}-{condition.proposer.replace(':', '.')}-{self.index:04d}"
