"""Where a schedule places robots and spots, and the stretches between two placements."""

from __future__ import annotations

import dataclasses

import numpy as np

from ...tasks.batch import Robots
from ...tasks.starts import random_poses, random_spots
from .schedules import Phase, Schedule, control_steps


@dataclasses.dataclass(frozen=True)
class Leg:
    """A stretch of a life between two placements, from control step `start` to `stop`."""

    start: int
    stop: int
    phase: Phase


def legs(schedule: Schedule) -> list[Leg]:
    """Cuts a schedule's phases at every placement."""
    result = []
    now = 0
    for phase, length in zip(schedule.phases, schedule.steps(), strict=True):
        end = now + length
        stride = control_steps(phase.every_minutes) if phase.every_minutes else length
        while now < end:
            result.append(Leg(now, min(now + stride, end), phase))
            now = result[-1].stop
    return result


def place(batch: Robots, phase: Phase, random: np.random.Generator) -> None:
    """Places spots, then robots, as a phase begins; in this order robots sense the new spots.

    Args:
      batch: Robots to place.
      phase: Phase that defines the places.
      random: Random stream from which random places are drawn.
    """
    everyone = np.arange(batch.robots)
    if phase.spot == "random":
        batch.place_spot(everyone, random_spots(random, batch.dimensions, batch.robots))
    elif phase.spot is not None:
        batch.place_spot(everyone, np.tile(phase.spot, (batch.robots, 1)))
    if phase.robot == "random":
        batch.place(everyone, random_poses(random, batch.dimensions, batch.robots))
    elif phase.robot is not None:
        batch.place(everyone, np.tile(phase.robot, (batch.robots, 1)))
