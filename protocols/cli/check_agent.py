"""`musebot check-agent`: checks that an agent keeps to the interface."""

from __future__ import annotations

import dataclasses
from typing import Annotated

import tyro

from ..terminal import say
from .shared_options import option

Name = Annotated[
    str, tyro.conf.Positional, tyro.conf.arg(metavar="AGENT", help_behavior_hint="(required)")
]


@dataclasses.dataclass
class CheckAgentCommand:
    """Check that an agent keeps to the interface, without a simulation; takes seconds.

    It is given the signals of each task. The exit status is 1 if the agent breaks a law.
    """

    agent: Name
    """a name that `musebot list agents` prints, or a factory of yours as package.module:factory"""
    agent_set: Annotated[tuple[str, ...], option("NAME=VALUE ..", "none")] = ()
    """settings of the agent to change"""

    def __call__(self) -> None:
        """Prints a line for each law that is broken.

        Raises:
          InputError: a value is invalid, or the agent cannot be made.
          RunError: the agent breaks a law, raises or exits.
        """
        from ...controller.proposers import PROPOSERS
        from ..agents.contract import check_agent
        from ..errors import InputError, RunError
        from ..lives.worker import prepare_process

        if self.agent in PROPOSERS:
            raise InputError(f"{self.agent} is a proposer of the brain, not an agent")
        prepare_process()  # one thread of torch, as in a run
        broken = check_agent(self.agent, self.agent_set)
        for sentence in broken:
            say(sentence)
        if broken:
            raise RunError(f"{self.agent} broke {len(broken)} laws of agents")
        say(f"{self.agent} passed all checks")
