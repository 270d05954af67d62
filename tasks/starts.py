"""Where episodes start: the paper's corners, fixed places and random ones."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping
from typing import Any, Literal

import numpy as np

from ..models.arena import Dimensions, arena_spec, half_size
from .episode import real_numbers

Corner = Literal["upper_left", "upper_right"]
Random = np.random.RandomState | np.random.Generator

FROM_WALLS = 0.10  # [m]; distance of a robot's centre to both walls of a corner (section 3.1)
_DRAWS = 10_000  # draws of a pose after which the arena counts as full
_TOLERANCE = 1e-9  # [m]; rounding of places computed from the arena's dimensions
_X, _Y = (half - FROM_WALLS for half in half_size(arena_spec()))
# x, y in [m] and heading in [rad] of a robot that faces the corner.
CORNERS: Mapping[str, tuple[float, float, float]] = {
    "upper_left": (-_X, _Y, math.atan2(1, -1)),
    "upper_right": (_X, _Y, math.atan2(1, 1)),
}


def random_poses(random: Random, dimensions: Dimensions, count: int) -> np.ndarray:
    """Draws poses uniformly over the arena, at least 1 cm clear of walls and obstacles.

    Returns x, y in [m] and heading in [rad], shape (count, 3). Raises ValueError where the
    obstacles leave no room for a robot.
    """
    clear = dimensions.radius + 0.01
    high = np.array([dimensions.half_length - clear, dimensions.half_width - clear, np.pi])
    poses = random.uniform(-high, high, (count, 3))
    obstacles = np.reshape(dimensions.obstacles, (-1, 3))
    for _ in range(_DRAWS):
        apart = np.hypot(*(poses[:, None, :2] - obstacles[:, :2]).transpose(2, 0, 1))
        blocked = (apart < obstacles[:, 2] + clear).any(axis=1)
        if not blocked.any():
            return poses
        poses[blocked] = random.uniform(-high, high, (int(blocked.sum()), 3))
    raise ValueError(f"the obstacles leave no room for a robot: {dimensions.obstacles}")


def random_spots(random: Random, dimensions: Dimensions, count: int) -> np.ndarray:
    """Draws centres of the spot uniformly, with the whole spot inside the arena.

    Returns x, y in [m], shape (count, 2).
    """
    r = dimensions.spot_radius
    high = np.array([dimensions.half_length - r, dimensions.half_width - r])
    return random.uniform(-high, high, (count, 2))


@dataclasses.dataclass(frozen=True)
class Start:
    """Places of robot and spot at the start of an episode.

    None draws a place for every episode; in a `Phase` of a life, "random" does.

    Attributes:
      robot: Pose of the robot: x, y in [m] and heading in [rad]; or a corner of the paper's arena
        that it faces, "upper_left" or "upper_right"; or None.
      spot: Centre of the spot: x, y in [m]; or a corner, see `robot`; or None.
    """

    robot: tuple[float, float, float] | Corner | None = None
    spot: tuple[float, float] | Corner | None = None

    def __post_init__(self) -> None:
        """Raises ValueError for an unknown corner or a place of the wrong shape."""
        for name, length in (("robot", 3), ("spot", 2)):
            place = getattr(self, name)
            if isinstance(place, str):
                if place not in CORNERS:
                    raise ValueError(f"{name} must be one of {list(CORNERS)}, got {place!r:.60}")
                place = CORNERS[place][:length]
            if place is not None:
                place = real_numbers(name, place, (length,), finite=True)
                object.__setattr__(self, name, tuple(map(float, place)))

    def check(self, dimensions: Dimensions) -> None:
        """Raises ValueError if the robot overlaps a wall or an obstacle, or the spot is outside."""
        size = dimensions
        for name, clear in (("robot", size.radius), ("spot", 0.0)):
            place: Any = getattr(self, name)
            if place is None:
                continue
            x, y = size.half_length - clear, size.half_width - clear
            if abs(place[0]) > x + _TOLERANCE or abs(place[1]) > y + _TOLERANCE:
                raise ValueError(
                    f"{name} must be inside the arena, |x| <= {x:g} and |y| <= {y:g}, got {place}"
                )
            for x, y, radius in size.obstacles if name == "robot" else ():
                least = radius + size.radius
                if math.hypot(place[0] - x, place[1] - y) < least - _TOLERANCE:
                    raise ValueError(
                        f"robot must be at least {least:g} m from the centre of the obstacle at "
                        f"({x:g}, {y:g}), got {place}"
                    )

    def draw(self, random: Random, dimensions: Dimensions) -> tuple[np.ndarray, np.ndarray]:
        """Returns a robot's pose, shape (3,), and a spot, shape (2,), drawn in this order."""
        robot, spot = self.robot, self.spot
        pose = random_poses(random, dimensions, 1)[0] if robot is None else np.array(robot)
        centre = random_spots(random, dimensions, 1)[0] if spot is None else np.array(spot)
        return pose, centre
