"""The networks of an experiment's brains: the signals that they receive, and their shapes."""

from __future__ import annotations

import functools
from collections.abc import Mapping
from types import MappingProxyType
from typing import TYPE_CHECKING

from ...controller.neurocontroller import Neurocontroller
from ...controller.senses import Senses, Signal
from ...tasks.suite import task_definition

if TYPE_CHECKING:
    from .conditions import Condition
    from .experiment import Experiment


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


@functools.lru_cache(maxsize=64)
def network_shapes(
    experiment: Experiment, condition: Condition
) -> Mapping[str, tuple[int, ...]] | None:
    """Returns the shape of each array of one robot's networks; None for an agent of a user's."""
    if not condition.has_brain:
        return None
    senses = senses_of(experiment.arena_task(condition.task))
    controller = Neurocontroller(
        experiment.brain, condition.proposer, 1, len(senses.state), 0, senses
    )
    shapes = {name: tuple(tensor.shape[1:]) for name, tensor in controller.networks().items()}
    return MappingProxyType(shapes)
