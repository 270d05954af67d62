"""Lives of the paper's brain in the kinematic simulator, compiled as one loop."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from ... import compiled_equations as equations
from ...tasks.kinematic import KinematicBatch
from ...tasks.spot_finding import SpotAmongWallsRules, SpotFindingRules
from ...tasks.wall_avoidance import WallAvoidanceRules

_RULES = (WallAvoidanceRules, SpotFindingRules, SpotAmongWallsRules)
_BLOCK = 500_000  # actions whose random numbers are drawn at once, so that these fit a cache


def simulate(
    brain: Any, batch: KinematicBatch, steps: int, learning: bool, counts: np.ndarray
) -> bool:
    """Simulates control steps of brains, a `CompiledNeurocontroller`, and their B robots.

    Adds each robot's number of events to `counts`, shape (B,). Returns False, and simulates
    nothing, where the loop cannot compute the robots' world.
    """
    if not compilable(batch):
        return False
    body, motion, robots = batch.compiled_arguments()
    world = body, motion, *world_numbers(batch)
    parts = brain.nets, brain.neurons, brain.now
    block = 1 + _BLOCK // (len(counts) * brain.actions)
    while steps:
        begun = brain.begin_steps(min(steps, block), learning)
        draws = brain.draw(begun, learning)
        equations.simulate(world, robots, parts, draws, learning, counts)
        steps -= begun
    return True


def compilable(batch: KinematicBatch) -> bool:
    """Returns whether the compiled loop can compute motion, sensors, task and world of robots.

    Worlds may differ in the wiring of the wheels and the angle of the nose.
    """
    world = batch.world
    bodily = not world.sensors and world.rewarded == "task"
    return batch.compiled and bodily and type(batch.task_rules) in _RULES


def world_numbers(batch: KinematicBatch) -> tuple[Any, Any, Any]:
    """Returns the numbers of task, wheels and nose that `equations.simulate` needs."""
    rules, angle = batch.task_rules, math.radians(batch.world.nose)
    smells, sees = isinstance(rules, SpotFindingRules), isinstance(rules, WallAvoidanceRules)
    nose = rules.nose if isinstance(rules, SpotFindingRules) else SpotFindingRules.nose
    odour, frustum, spot = map(float, (nose.odour, nose.frustum, nose.spot_radius))
    task = equations.Task(smells, sees, odour, frustum, spot, nose.form == "printed")
    turn = math.cos(angle), math.sin(angle), float(batch.dimensions.nose)
    return task, tuple(map(np.float32, batch.world.wheels)), turn
