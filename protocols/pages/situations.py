"""Typical situations of a robot, and a grid of all actions, for figures of values."""

from __future__ import annotations

import numpy as np
import torch

from ...tasks import Robots
from ..lives.schedules import UPPER_LEFT, UPPER_RIGHT

GRID = 41  # motor values along each side of the grid of all actions


def grid() -> torch.Tensor:
    """Returns actions on a grid over all motor values, left motor first.

    Returns:
      Motor values in [-0.5, 0.5], shape (1, 41 x 41, 2).
    """
    line = torch.linspace(-0.5, 0.5, GRID)
    return torch.cartesian_prod(line, line)[None]


def situations(batch: Robots, task: str) -> dict[str, np.ndarray]:
    """Returns the sensor signals of a robot in three typical situations of a task.

    Args:
      batch: Batch of one robot, which is placed in each situation.
      task: Task of the batch.

    Returns:
      Sensor signals by the name of the situation, each of shape (S,).
    """
    size, one = batch.dimensions, np.array([0])
    reach = size.half_length - size.radius
    places: dict[str, tuple[tuple[float, float, float], bool]]
    if task == "wall_avoidance":
        places = {
            "in the open": ((0.0, 0.0, 0.0), False),
            "a wall 3 cm ahead": ((reach - 0.03, 0.0, 0.0), False),
            "pressed against it": ((reach - 0.002, 0.0, 0.0), True),
        }
    else:
        x, y, _ = UPPER_RIGHT
        places = {
            "no smell": (UPPER_LEFT, False),
            "spot 20 cm ahead": ((x - size.nose - 0.2, y, 0.0), False),
            "inside the spot": ((x - size.nose, y, 0.0), False),
        }
    states = {}
    for name, (pose, pressed) in places.items():
        batch.place_spot(one, np.array([UPPER_RIGHT[:2]]))
        batch.place(one, np.array([pose]))
        for _ in range(3 if pressed else 0):
            batch.step(np.array([[0.5, 0.5]]))
        states[name] = batch.rules.state(batch.sensordata)[0]
    return states
