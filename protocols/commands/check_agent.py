"""`musebot check-agent`: checks that an agent keeps to the interface."""

from __future__ import annotations

import dataclasses
from typing import Annotated

import tyro

from ..shared_options import TASK_CHOICES, option
from ..terminal import say

Name = Annotated[
    str, tyro.conf.Positional, tyro.conf.arg(metavar="AGENT", help_behavior_hint="(required)")
]


@dataclasses.dataclass
class CheckAgentCommand:
    """Check that an agent keeps to the interface, in about a minute and without a simulation.

    A line for each check: ok, FAILED or a remark. The exit status is 1 if one has failed.
    """

    agent: Name
    """a name that `musebot list agents` prints, or a factory of yours as package.module:factory"""
    task: Annotated[str, option(TASK_CHOICES, "spot_finding")] = "spot_finding"
    """task whose signals it is given"""
    signals: Annotated[str, option("{paper,raw}", "paper")] = "paper"
    """raw: smell and reward before they saturate"""
    agent_set: Annotated[tuple[str, ...], option("NAME=VALUE ..", "none")] = ()
    """settings of the agent to change"""

    def __call__(self) -> None:
        """Prints a line for each check.

        Raises:
          InputError: a value is invalid, or the agent cannot be made.
          RunError: the agent fails a check, raises or exits.
        """
        from ..agents.agent_check import checks
        from ..agents.names import recorded_name
        from ..agents.trust import trust
        from ..errors import InputError, RunError
        from ..experiment.conditions import Condition
        from ..experiment.experiment import Experiment

        name = recorded_name(self.agent)
        condition = Condition(self.task, name)
        if condition.has_brain:
            raise InputError(f"{name} is a proposer of the brain, not an agent")
        settings = tuple(self.agent_set)
        experiment = Experiment(signals=self.signals, settings=settings)  # type: ignore[arg-type]
        trust(name)
        failed = 0
        for check in checks(experiment, condition):
            word = {True: "ok", False: "FAILED", None: "-"}[check.passed]
            failed += check.passed is False
            say(f"{word:7} {check.name}: {check.says}")
        if failed:
            raise RunError(f"{self.agent} failed {failed} of the checks")
