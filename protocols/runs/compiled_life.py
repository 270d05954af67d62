"""Lives of the paper's brain in the kinematic simulator, compiled as one loop."""

from __future__ import annotations

from typing import Any

import numpy as np

from ... import compiled_equations as equations
from ...controller.compiled import CompiledNeurocontroller
from ...tasks.episode import CONTROL_TIMESTEP
from ...tasks.kinematic import KinematicBatch
from ...tasks.spot_finding import SpotAmongWallsRules, SpotFindingRules
from ...tasks.wall_avoidance import WallAvoidanceRules

_RULES = (WallAvoidanceRules, SpotFindingRules, SpotAmongWallsRules)
_BLOCK = 500_000  # actions whose random numbers are drawn at once: they fit a cache


class CompiledLife:
    """Simulates control steps of brains and their robots in one compiled loop."""

    def __init__(self, brain: Any, batch: KinematicBatch) -> None:
        """Takes a `CompiledNeurocontroller`, and robots that are `compilable`."""
        self._brain: CompiledNeurocontroller = brain
        names = ("poses", "wheels", "touch", "spots", "sensordata", "valid")
        self._robots = tuple(batch.arrays()[name] for name in names)
        self._world = world_of(batch)

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
    how, layout = batch.kinematics, batch.rules.layout
    places = layout.distances.start, layout.touch.start, layout.smell.start
    return (
        type(batch.rules) in _RULES
        and how.wall in ("holds", "refuses")
        and not how.lag
        and not how.any_contact
        and places == (equations.DISTANCES, equations.TOUCH, equations.SMELL)
    )


def world_of(batch: KinematicBatch) -> Any:
    """Returns the numbers of a batch that the compiled loop reads, see `equations.simulate`."""
    rules, size, how = batch.rules, batch.dimensions, batch.kinematics
    room = size.half_length - size.radius, size.half_width - size.radius
    speed = 2 * size.motor_speed  # [m/s] for a motor value of 1
    body = *room, size.wheel_base, speed, size.radius, size.nose, size.contact_margin
    path = how.wall == "refuses", how.felt == "pushed", how.path == "arc"
    smells, sees = isinstance(rules, SpotFindingRules), isinstance(rules, WallAvoidanceRules)
    nose = rules.nose if isinstance(rules, SpotFindingRules) else SpotFindingRules.nose
    numbers = map(float, (nose.odour, nose.frustum, nose.spot_radius))
    task = smells, sees, *numbers, nose.form == "printed"
    seconds = CONTROL_TIMESTEP / how.pieces
    return tuple(map(float, body)), (*path, seconds, how.pieces), task
