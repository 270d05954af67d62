"""A stand-in for the body: an ideal differential drive, without mass or, unless told, slip.

It moves on the same floor between the same walls, with the same sensors, so that what physics
does to a life can be told from what the brain does. When it feels a wall, and what it does at one,
is told (`Kinematics`). The paper's own simulator was of this kind.
"""

from __future__ import annotations

import dataclasses
from typing import Literal

import numpy as np

from .arena import Dimensions

Wall = Literal["holds", "slides", "sticks", "turns"]
WALLS: tuple[Wall, ...] = ("holds", "slides", "sticks", "turns")
Felt = Literal["near", "pushed"]
FEELINGS: tuple[Felt, ...] = ("near", "pushed")

# What a wall does to the real body that drives into it, by the angle in degrees from head-on:
# the share of its speed that it keeps, along the wall, slow and fast, and how fast it turns
# towards the wall at full speed, in rad/s; slower, it turns less. Measured by
# tests/test_kinematic.py; how far they hold: docs/physics.md.
_ANGLES = (0, 30, 40, 50, 57, 63, 69, 75, 78, 81, 84, 87, 90)
_SLOW_SLIPS = (0, 0.004, 0.007, 0.013, 0.02, 0.035, 0.06, 0.12, 0.25, 0.57, 0.68, 0.81, 1)
_SLIPS = (0, 0.006, 0.010, 0.017, 0.09, 0.19, 0.36, 0.57, 0.65, 0.74, 0.83, 0.94, 1)
_TURNS = (0, 0, 0, 0, 0.13, 0.31, 0.44, 0.50, 0.42, 0.30, 0.10, 0.01, 0)
_SLIPPING_SPEEDS = (0.08, 0.2)  # in m/s: up to the first it slips as slow ones do, then more
_TURNING_SPEEDS = (0.14, 0.2)  # in m/s: up to the first it does not turn, from the second on fully


@dataclasses.dataclass(frozen=True)
class Kinematics:
    """What an ideal differential drive needs to be told; None takes it from the real body.

    Attributes:
      radius: the robot's, in metres.
      wheel_base: distance between the wheels, in metres.
      wall: what a robot does that drives into a wall. "holds": it stops there, free to turn;
        "slides": along the wall, too; "sticks": it can do neither, only back off; "turns": it
        does as the real body, which slips along walls that it grazes and is turned towards them.
      felt: when a robot feels a wall. "near": where its rim is within the contact margin of one;
        "pushed": only while its wheels push it into one, as the real body's does, which a wall
        that it does not push pushes off.
      any_contact: whether contact is felt wherever there was one during a control step;
        else where there is one at its end.
      lag: seconds after which a wheel has made 63 % of a change of its speed; 0 for at once. The
        real body's, from its mass and its servos, is about 0.08 driving straight ahead.
      pieces: equal parts of a control step, each along one arc.
    """

    radius: float | None = None
    wheel_base: float | None = None
    wall: Wall = "holds"
    felt: Felt = "near"
    any_contact: bool = False
    lag: float = 0.0
    pieces: int = 4

    def __post_init__(self) -> None:
        """Raises ValueError, naming the field, where a number makes no sense."""
        for name in ("radius", "wheel_base", "lag"):
            if type(getattr(self, name)) not in (int, float, type(None)):
                raise ValueError(f"{name} must be a number, got {getattr(self, name)!r}")
        for name in ("radius", "wheel_base"):
            value = getattr(self, name)
            if value is not None and not 0 < value < np.inf:
                raise ValueError(f"{name} must be positive, got {value}")
        if self.wall not in WALLS:
            raise ValueError(f"wall must be one of {', '.join(WALLS)}, got {self.wall!r}")
        if self.felt not in FEELINGS:
            raise ValueError(f"felt must be one of {', '.join(FEELINGS)}, got {self.felt!r}")
        if not 0 <= self.lag < np.inf:
            raise ValueError(f"lag must not be negative, got {self.lag}")
        if not isinstance(self.any_contact, bool):
            raise ValueError(f"any_contact must be true or false, got {self.any_contact!r}")
        if type(self.pieces) is not int or self.pieces < 1:
            raise ValueError(f"pieces must be a whole number of at least 1, got {self.pieces}")

    def applied_to(self, dimensions: Dimensions) -> Dimensions:
        """The dimensions of an arena, with this robot in it."""
        return dataclasses.replace(
            dimensions,
            radius=self.radius or dimensions.radius,
            wheel_base=self.wheel_base or dimensions.wheel_base,
        )


def catch_up(
    wheels: np.ndarray, motors: np.ndarray, seconds: float, lag: float
) -> tuple[np.ndarray, np.ndarray]:
    """How fast wheels turn that follow their motors with a lag.

    Args:
      wheels: how fast they turned, in motor values, shape (B, 2).
      motors: what they are told since, shape (B, 2).
      seconds: how long they have been told.
      lag: see `Kinematics`.

    Returns:
      In motor values, shape (B, 2): on average, and now.
    """
    if not lag:
        return motors, motors
    left = np.exp(-seconds / lag)
    missing = wheels - motors
    return motors + missing * ((1 - left) * lag / seconds), motors + missing * left


def drive(
    poses: np.ndarray, motors: np.ndarray, seconds: float, wall: Wall, size: Dimensions
) -> tuple[np.ndarray, np.ndarray]:
    """Moves robots along the arcs that their wheels roll, as far as the walls let them.

    Args:
      poses: x, y in metres and heading in radians, shape (B, 3).
      motors: left and right, in [-0.5, 0.5], shape (B, 2).
      seconds: how long.
      wall: see `Kinematics`.
      size: of robot and arena.

    Returns:
      The poses reached, shape (B, 3); and whose wheels push them into a wall, shape (B,).
    """
    left, right = (motors * (2 * size.motor_speed)).T
    turn = (right - left) / size.wheel_base * seconds
    # The chord of the arc: at half the turn, shorter than the arc by sin(x) / x.
    length = (left + right) / 2 * seconds * np.sinc(turn / (2 * np.pi))
    along = poses[:, 2] + turn / 2
    start, step = poses[:, :2].T, length * np.array([np.cos(along), np.sin(along)])
    room = np.array([[size.half_length], [size.half_width]]) - size.radius
    target = start + step
    reached = np.minimum(np.maximum(target, -room), room)
    pushing = (reached != target).any(axis=0)
    if wall == "sticks":
        turn = np.where(pushing, 0.0, turn)
    if wall != "slides":
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
            shares = (np.copysign(room, step) - start) / step
        shares[step == 0] = 1
        share = np.minimum(np.maximum(shares.min(axis=0), 0), 1)
        held = start + share * step
        if wall == "turns":
            left_over, speed = 1 - share, np.abs(left + right) / 2
            met = (shares <= share) & (share < 1)
            slip, turned = graze(left_over * step, met, speed, left_over * seconds)
            held, turn = held + slip, turn + turned
        reached = np.minimum(np.maximum(held, -room), room)
    return np.array([*reached, poses[:, 2] + turn]).T, pushing


def graze(
    lost: np.ndarray, into: np.ndarray, speed: np.ndarray, seconds: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """What a wall does to robots that drive into it at an angle, as measured on the real body.

    In a corner, between two walls, a robot is held.

    Args:
      lost: the way that a wall keeps them from going: x, y in metres, shape (2, B).
      into: whether the wall that they meet first is at the end of x, or of y, shape (2, B).
      speed: of the robots, in m/s, shape (B,).
      seconds: how long they drive into the wall, shape (B,).

    Returns:
      How far they slip along the wall: x, y in metres, shape (2, B); and how far they are turned,
      in radians, counterclockwise, shape (B,).
    """
    ahead, along = np.where(into, lost, 0), np.where(into, 0, lost)
    angle = np.degrees(np.arctan2(np.abs(along).sum(axis=0), np.abs(ahead).sum(axis=0)))
    slow, fast = (np.interp(angle, _ANGLES, kept) for kept in (_SLOW_SLIPS, _SLIPS))
    kept = slow + (fast - slow) * np.interp(speed, _SLIPPING_SPEEDS, (0, 1))
    slip = np.sign(along) * np.hypot(*lost) * kept
    rate = np.interp(angle, _ANGLES, _TURNS) * np.interp(speed, _TURNING_SPEEDS, (0, 1))
    towards = np.sign(along[0] * ahead[1] - along[1] * ahead[0])
    return slip, towards * rate * seconds


def gaps(poses: np.ndarray, size: Dimensions) -> np.ndarray:
    """From the robots' rims to the nearest wall, in metres, shape (B,)."""
    room = np.array([size.half_length, size.half_width]) - np.abs(poses[:, :2])
    return room.min(axis=1) - size.radius


def distances(poses: np.ndarray, size: Dimensions) -> np.ndarray:
    """What rangefinders on the rim read, front, back, left and right, in metres, shape (B, 4)."""
    angles = poses[:, 2, None] + np.array([0, np.pi, np.pi / 2, -np.pi / 2])
    heading = np.stack([np.cos(angles), np.sin(angles)], axis=-1)
    walls = np.copysign([size.half_length, size.half_width], heading)
    with np.errstate(divide="ignore"):
        rays = (walls - poses[:, None, :2]) / heading
    return np.maximum(rays.min(axis=-1) - size.radius, 0)


def seen_from_nose(poses: np.ndarray, spots: np.ndarray, size: Dimensions) -> np.ndarray:
    """Spots in the frame of the nose at the front of the rim: ahead, to the left, shape (B, 2).

    Args:
      poses: x, y in metres and heading in radians, shape (B, 3).
      spots: x, y in metres, shape (B, 2).
      size: of the robot.
    """
    offset = spots - poses[:, :2]
    cosine, sine = np.cos(poses[:, 2]), np.sin(poses[:, 2])
    ahead = cosine * offset[:, 0] + sine * offset[:, 1] - size.radius
    return np.stack([ahead, cosine * offset[:, 1] - sine * offset[:, 0]], axis=1)
