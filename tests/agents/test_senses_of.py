"""The senses that each task describes to a brain."""

import pytest

from musebot.protocols.agents.base import senses_of
from musebot.tasks.suite import TASKS


@pytest.mark.parametrize("task", TASKS)
def test_every_task_describes_its_signals(task):
    senses = senses_of(task)
    rules = TASKS[task].rules
    assert len(senses.state) == sum(length for length, _, _ in rules.shapes.values())
    assert (senses.reward.low, senses.reward.high) == rules.rewards
    assert set(rules.full) <= {*rules.shapes, "reward"}
