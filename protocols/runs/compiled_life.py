"""Lives of the paper's brain in the kinematic simulator, compiled as one loop."""

from __future__ import annotations

from typing import Any

import numpy as np

from ... import compiled_equations as equations
from ...controller.compiled import CompiledNeurocontroller
from ...tasks.kinematic import KinematicBatch
from ...tasks.spot_finding import SpotAmongWallsRules, SpotFindingRules
from ...tasks.wall_avoidance import WallAvoidanceRules

_RULES = (WallAvoidanceRules, SpotFindingRules, SpotAmongWallsRules)
_BLOCK = 500_000  # actions whose random numbers are drawn at once, so that these fit a cache


class CompiledLife:
    """Simulates control steps of brains and their robots in one compiled loop."""

    def __init__(self, brain: Any, batch: KinematicBatch) -> None:
        """Takes a `CompiledNeurocontroller`, and robots that are `compilable`."""
        self._brain: CompiledNeurocontroller = brain
        size, how, self._robots = batch.compiled_arguments()
        self._world = size, how, task_numbers(batch)

    def __call__(self, steps: int, learning: bool, counts: np.ndarray) -> None:
        """Simulates control steps; adds each robot's number of events to `counts`, shape (B,)."""
        brain = self._brain
        parts = brain.nets, brain.neurons, brain.now
        block = 1 + _BLOCK // (len(counts) * brain.actions)
        while steps:
            begun = brain.begin_steps(min(steps, block), learning)
            draws = brain.draw(begun, learning)
            equations.simulate(self._world, self._robots, parts, draws, learning, counts)
            steps -= begun


def compilable(batch: KinematicBatch) -> bool:
    """Returns whether the compiled loop can compute motion, sensors and task of these robots."""
    return batch.compiled and type(batch.rules) in _RULES


def task_numbers(batch: KinematicBatch) -> Any:
    """Returns the parameters of the robots' task that `equations.simulate` needs."""
    rules = batch.rules
    smells, sees = isinstance(rules, SpotFindingRules), isinstance(rules, WallAvoidanceRules)
    nose = rules.nose if isinstance(rules, SpotFindingRules) else SpotFindingRules.nose
    numbers = map(float, (nose.odour, nose.frustum, nose.spot_radius))
    return smells, sees, *numbers, nose.form == "printed"
