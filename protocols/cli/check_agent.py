"""`musebot check-agent`: checks that an agent keeps to the interface."""

from __future__ import annotations

import dataclasses
from typing import Annotated

import tyro

from ..terminal import say
from .shared_options import TASK_CHOICES, option

Name = Annotated[
    str, tyro.conf.Positional, tyro.conf.arg(metavar="AGENT", help_behavior_hint="(required)")
]


@dataclasses.dataclass
class CheckAgentCommand:
    """Check that an agent keeps to the interface, without a simulation; takes seconds.

    A line for each check: ok, FAILED or a remark. The exit status is 1 if one has failed.
    """

    agent: Name
    """a name that `musebot list agents` prints, or a factory of yours as package.module:factory"""
    task: Annotated[tuple[str, ...], option(f"{TASK_CHOICES} ..", "those of the protocol")] = ()
    """tasks whose signals it is given"""
    protocol: Annotated[str, option("{paper,walls}", "paper")] = "paper"
    """walls: spot finding with walls sensed, as on the board walls"""
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
        from ..agents.names import recorded_name
        from ..agents.trust import trust
        from ..compare.agent_check import checks
        from ..errors import InputError, RunError
        from ..lives.conditions import Condition
        from ..lives.experiment import Experiment
        from ..lives.plan import Plan
        from ..lives.worker import prepare_process

        name = recorded_name(self.agent)
        settings = tuple(self.agent_set)
        experiment = Experiment(
            signals=self.signals,  # type: ignore[arg-type]
            settings=settings,
            protocol=self.protocol,  # type: ignore[arg-type]
        )
        conditions = [Condition(task, name) for task in self.task or experiment.tasks]
        Plan.of(experiment, conditions, experiment.cohort_size)  # refuses tasks of other protocols
        if conditions[0].has_brain:
            raise InputError(f"{name} is a proposer of the brain, not an agent")
        trust(name)
        prepare_process()  # one thread of torch, as in a run
        failed = 0
        for condition in conditions:
            for number, check in enumerate(checks(experiment, condition)):
                if not number:  # now the agent has been made
                    say(f"{experiment.arena_task(condition.task)}, {self.signals} signals")
                word = {True: "ok", False: "FAILED", None: "-"}[check.passed]
                failed += check.passed is False
                say(f"{word:7} {check.name}: {check.says}")
        if failed:
            raise RunError(f"{self.agent} failed {failed} of the checks")
        say(f"{self.agent} passed all checks")
