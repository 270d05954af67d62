"""The ranges of the signals that the robots of a task observe."""

from __future__ import annotations

from ...controller.senses import Senses, Signal
from ...tasks.suite import task_definition


def senses_of(task: str) -> Senses:
    """Returns the ranges of the signals that the robots of a task observe.

    Raises:
      ValueError: there is no such task.
    """
    rules = task_definition(task).rules
    signals = [
        Signal(low, high, rules.maximal.get(name))
        for name, (length, low, high) in rules.shapes.items()
        for _ in range(length)
    ]
    return Senses(tuple(signals), Signal(*rules.rewards, rules.maximal.get("reward")))
