"""The kinematic simulator: an ideal differential drive without mass, between the same walls.

It has the floor, the walls and the sensors of the MuJoCo body, so that comparing the two separates
the effects of physics from those of the brain. The functions take arrays of NumPy, or tensors of
PyTorch on any device, and return the same kind. Poses are x, y in [m] and heading in [rad], shape
(B, 3). Motor values are left and right, in [-0.5, 0.5], shape (B, 2).
"""

from __future__ import annotations

import dataclasses
from typing import Literal, get_args

import numpy as np

from ..fields import Checked, choice, flag, number, whole
from .arena import Dimensions
from .arrays import at_least, at_most, namespace, replaced

Wall = Literal["holds", "slides", "sticks", "slips", "refuses"]
WALLS: tuple[Wall, ...] = get_args(Wall)
Felt = Literal["near", "pushed"]
Path = Literal["arc", "euler"]

# Friction force of the loaded tyres divided by the loss of motor force per speed, in [m/s]: a wall
# straight ahead slows the wheels by up to this speed (docs/physics.md). It is that of the model's
# motors, whose top speed is `GRIP_SPEED`; see `grip`.
GRIP, GRIP_SPEED = 0.436, 0.2


@dataclasses.dataclass(frozen=True)
class Kinematics(Checked):
    """Settings of the kinematic simulator; None takes the value of the MuJoCo body.

    Attributes:
      radius: Radius of the robot in [m].
      wheel_base: Distance between the wheels in [m].
      wall: Motion of a robot that drives into a wall. "holds": it stops and is free to turn.
        "slides": it moves along the wall. "sticks": it can only reverse. "slips": it slips along
        the wall as the tyres of the MuJoCo body do, by Coulomb's law. "refuses": a move that would
        overlap a wall is not made, not even in part; the robot still turns.
      felt: Condition for contact. "near": the gap between rim and wall is within the contact
        margin. "pushed": the wheels push the robot into a wall or, with the wall "refuses", a move
        is refused. "pushed" resembles MuJoCo, where a wall pushes away a robot that stands or
        spins.
      any_contact: Whether contact at any time of a control step counts; otherwise only contact at
        the end of the step counts.
      lag: Time constant in [s] with which the wheels' speed follows the motor values; 0 for no lag.
        For the MuJoCo body driving straight ahead, it is about 0.08 s, because of mass and servos.
      pieces: Number of equal pieces into which a control step is divided; the robot follows one
        path in each.
      path: Path in each of the `pieces`. "arc": exact for two wheels of constant speed. "euler":
        one step of Euler's method, straight along the heading at the start of the piece.
    """

    radius: float | None = number(None, 0, 0.1, "()", unit="m")  # a start is 10 cm from walls
    wheel_base: float | None = number(None, 0.001, 10, unit="m")  # a wider robot hardly turns
    wall: Wall = choice("holds", Wall)
    felt: Felt = choice("near", Felt)
    any_contact: bool = flag(False)
    lag: float = number(0.0, 0, 1000, unit="s")  # with a longer one, a robot hardly moves
    pieces: int = whole(4, 1, 1000)  # far more than change a path
    path: Path = choice("arc", Path)

    def applied_to(self, dimensions: Dimensions) -> Dimensions:
        """Returns an arena's dimensions with the radius and wheel base of these settings."""
        return dataclasses.replace(
            dimensions,
            radius=self.radius or dimensions.radius,
            wheel_base=self.wheel_base or dimensions.wheel_base,
            nose=self.radius if self.radius and dimensions.nose else dimensions.nose,
        )


def follow_motors(
    wheels: np.ndarray, motors: np.ndarray, seconds: float, lag: float
) -> tuple[np.ndarray, np.ndarray]:
    """Returns the mean and the final speeds of wheels that follow their motors for some seconds.

    `wheels` are the speeds at the start, `lag` the time constant in [s]. Speeds are expressed as
    motor values, left and right, shape (B, 2).
    """
    if not lag:
        return motors, motors
    left = float(np.exp(-seconds / lag))
    missing = wheels - motors
    return motors + missing * ((1 - left) * lag / seconds), motors + missing * left


def drive(
    poses: np.ndarray, motors: np.ndarray, seconds: float, how: Kinematics, size: Dimensions
) -> tuple[np.ndarray, np.ndarray]:
    """Moves robots along one path for some seconds, as far as the walls allow.

    Returns the poses at the end, and whether each robot's wheels push it into a wall, shape (B,).
    """
    xp = namespace(poses)
    left, right = (motors * (2 * size.motor_speed)).T
    turn = (right - left) / size.wheel_base * seconds
    length, along = (left + right) / 2 * seconds, poses[:, 2]
    if how.path == "arc":
        # The chord of the arc points along half the turn; it is shorter than the arc by sin(x) / x.
        length, along = length * xp.sinc(turn / (2 * np.pi)), along + turn / 2
    start, step = poses[:, :2].T, length * xp.stack([xp.cos(along), xp.sin(along)])
    target = start + step
    sides = size.half_length - size.radius, size.half_width - size.radius
    room = xp.stack([xp.full_like(own, side) for own, side in zip(target, sides, strict=True)])
    reached = xp.minimum(xp.maximum(target, -room), room)
    pushing = xp.any(reached != target, axis=0)
    if how.wall == "sticks":
        turn = replaced(turn, pushing, 0.0)
    if how.wall == "refuses":
        reached = xp.where(pushing, start, target)
    elif how.wall != "slides":
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
            shares = (xp.copysign(room, step) - start) / step
        shares = replaced(shares, step == 0, 1.0)
        share = at_most(at_least(xp.amin(shares, axis=0), 0.0), 1.0)
        held = start + share * step
        if how.wall == "slips":
            met = (shares <= share) & (share < 1)
            held = held + slip((1 - share) * step, met, grip(size) * ((1 - share) * seconds))
        reached = xp.minimum(xp.maximum(held, -room), room)
    return xp.stack([*reached, poses[:, 2] + turn]).T, pushing


def grip(size: Dimensions) -> float:
    """Returns the speed that friction takes from the wheels at a wall straight ahead, in [m/s].

    Faster motors of the same torque lose less force per speed, so that friction takes more speed.
    """
    return GRIP * (size.motor_speed / GRIP_SPEED)


def slip(lost: np.ndarray, into: np.ndarray, held: np.ndarray) -> np.ndarray:
    """Returns how far robots slip along a wall, by Coulomb's law: x, y in [m], shape (2, B).

    The tyres slip perpendicular to the wall; their friction slows the wheels (docs/physics.md).
    Only motion along the wall remains. In a corner, between two walls, the robot stays.

    Args:
      lost: Displacement that the wall prevents: x, y in [m], shape (2, B).
      into: Booleans, shape (2, B). Row 0: whether the wall that the robot meets limits x. Row 1:
        whether it limits y. In a corner, both are true.
      held: Distance that friction takes from the wheels at a wall straight ahead: `grip` times the
        duration of driving into the wall, in [m], shape (B,).
    """
    xp = namespace(lost)
    length, ahead = (xp.hypot(*part) for part in (lost, replaced(lost, ~into, 0.0)))
    with np.errstate(divide="ignore", invalid="ignore"):
        kept = at_least(1 - held * ahead / (length * length), 0.0)
    return replaced(replaced(lost, into, 0.0) * kept, length == 0, 0.0)


def gaps(poses: np.ndarray, size: Dimensions) -> np.ndarray:
    """Returns the distances from the robots' rims to the nearest wall in [m], shape (B,)."""
    xp = namespace(poses)
    lengthwise = size.half_length - xp.abs(poses[:, 0])
    return xp.minimum(lengthwise, size.half_width - xp.abs(poses[:, 1])) - size.radius


def distances(poses: np.ndarray, size: Dimensions) -> np.ndarray:
    """Returns the rangefinders' distances in [m]: front, back, left, right, shape (B, 4)."""
    xp, heading = namespace(poses), poses[:, 2]
    turns = (0.0, np.pi, np.pi / 2, -np.pi / 2)
    angles = xp.stack([heading + turn for turn in turns], axis=-1)
    rays = []
    for part, half, own in (
        (xp.cos(angles), size.half_length, poses[:, 0, None]),
        (xp.sin(angles), size.half_width, poses[:, 1, None]),
    ):
        with np.errstate(divide="ignore", over="ignore"):
            rays.append((xp.copysign(xp.full_like(part, half), part) - own) / part)
    return at_least(xp.minimum(*rays) - size.radius, 0.0)


def spot_from_nose(poses: np.ndarray, spots: np.ndarray, size: Dimensions) -> np.ndarray:
    """Returns the spots' centres in the frame of the nose: ahead and left in [m], shape (B, 2)."""
    offset = spots - poses[:, :2]
    xp = namespace(poses)
    cosine, sine = xp.cos(poses[:, 2]), xp.sin(poses[:, 2])
    ahead = cosine * offset[:, 0] + sine * offset[:, 1] - size.nose
    left = cosine * offset[:, 1] - sine * offset[:, 0]
    return xp.stack([ahead, left], axis=1)
