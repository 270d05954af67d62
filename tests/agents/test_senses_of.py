"""The senses that each task describes to a brain."""

import pytest

from musebot.controller.senses import Senses, Signal
from musebot.protocols.agents.senses import senses_of
from musebot.tasks.suite import TASKS

DISTANCES, CONTACT = (Signal(0, 1),) * 4, Signal(-1, 0)
SMELL, SPEED = Signal(0, 1, maximal=10), Signal(-1, 1)
PUNISHED, PAID = Signal(-1, 0), Signal(0, 1)
SENSES = {
    "wall_avoidance": Senses((*DISTANCES, CONTACT), PUNISHED),
    "wall_avoidance_unit": Senses((*DISTANCES, CONTACT), PAID),
    "wall_avoidance_obstacles": Senses((*DISTANCES, CONTACT, SPEED), PAID),
    "spot_finding": Senses((SMELL,), SMELL),
    "spot_finding_unit": Senses((SMELL,), SMELL),
    "spot_finding_jumping": Senses((SMELL,), SMELL),
    "spot_finding_two_noses": Senses((SMELL, SMELL), SMELL),
    "spot_finding_walls": Senses((SMELL, *DISTANCES, CONTACT), SMELL),
}


@pytest.mark.parametrize("task", TASKS)
def test_every_task_describes_its_signals_and_its_reward(task):
    assert senses_of(task) == SENSES[task]
