"""How robots behave, measured from their recorded poses: spinning, and staying at the spot."""

from __future__ import annotations

import dataclasses

import numpy as np

from ...tasks import CONTROL_TIMESTEP
from ..runs.conditions import Condition

_SECOND = round(1 / CONTROL_TIMESTEP)  # control steps
_STATIONARY = 0.02  # [m/s]; speed below which a robot counts as stationary
_TURNING = 1.0  # [rad/s]; turning rate above which a robot counts as turning
RIM = 0.02  # [m]; distance from the spot's rim within which the nose counts as at the rim
_STAYING = 0.1  # share of the time at the spot from which a robot counts as staying


@dataclasses.dataclass(frozen=True)
class Track:
    """Motion and events of B robots at the start and after each of T control steps."""

    poses: np.ndarray  # x, y in [m] and heading in [rad], shape (T + 1, B, 3)
    events: np.ndarray  # whether in contact (or in the spot) after every step, shape (T, B)
    spots: np.ndarray  # x, y of each robot's spot at the end, in [m], shape (B, 2)
    # The spot's centre as seen from the nose after every step, in [m]: ahead, and to the left.
    nose: np.ndarray  # shape (T, B, 2)


@dataclasses.dataclass(frozen=True)
class Stay:
    """Behaviour of n robots that start at the rim of the spot and learn from there.

    A robot is at the spot while its nose is inside it or within 2 cm of its rim.

    Attributes:
      staying: Whether each robot was at the spot in at least a tenth of all seconds, shape (n,).
      following: Share of time in which each robot followed the contour, in the first and in the
        last third of its time at the spot, shape (n, 2); NaN if it was there in no whole second.
      spinning: Share of time in which each robot spun inside the spot, in the first and in the last
        third of its time at the spot, shape (n, 2); NaN if it was there in no whole second.
      minutes: In each minute, the share of following the contour, and of spinning inside, shape
        (M, 2). These are shares of the time in this minute that the staying robots were at the
        spot; NaN if none was.
    """

    staying: np.ndarray
    following: np.ndarray
    spinning: np.ndarray
    minutes: np.ndarray


@dataclasses.dataclass(frozen=True)
class Behaviour:
    """Behaviour of a sample of a run's robots.

    Arrays have shape (n, 2): a row for each robot, with its values before and after training.
    """

    spinning: dict[Condition, np.ndarray]  # share of time in which each robot spins
    stays: dict[str, Stay]  # of untrained robots that start at the spot's rim, by proposer
    # By how many metres each robot came nearer to the arena's centre.
    nearer: dict[Condition, np.ndarray] = dataclasses.field(default_factory=dict)


def spins(poses: np.ndarray) -> np.ndarray:
    """Returns in which seconds robots spin: they turn by more than 1 rad and move less than 2 cm.

    Args:
      poses: x, y in [m] and heading in [rad] at every control step, shape (T + 1, B, 3).

    Returns:
      Whether each robot spins in each whole second, shape (T // 10, B), or (1, B) for T < 10.
    """
    distance, turn = _seconds(poses)
    return (distance < _STATIONARY) & (turn > _TURNING)


def stay_of(track: Track, spot_radius: float) -> Stay:
    """Measures which robots follow the contour of the spot and which spin inside it.

    In a second, a robot follows the contour if its nose stays within 2 cm of the spot's rim and
    the robot moves more than 2 cm. It spins inside if it spins and its nose stays in the spot.
    `spot_radius` is in [m].
    """
    moved, _ = _seconds(track.poses)
    seconds = len(moved)
    stride = (len(track.poses) - 1) // seconds
    distance = np.linalg.norm(track.nose, axis=-1)[: seconds * stride]
    distance = distance.reshape(seconds, stride, -1)
    near = (distance < spot_radius + RIM).all(axis=1)
    follows = near & (distance > spot_radius - RIM).all(axis=1) & (moved > _STATIONARY)
    inside = (distance < spot_radius).all(axis=1) & spins(track.poses)
    staying = near.mean(axis=0) >= _STAYING
    minutes = [slice(60 * minute, 60 * minute + 60) for minute in range(-(-seconds // 60))]
    there, kinds = near[:, staying], (follows[:, staying], inside[:, staying])
    return Stay(
        staying,
        np.array([_thirds(*pair) for pair in zip(follows.T, near.T, strict=True)]),
        np.array([_thirds(*pair) for pair in zip(inside.T, near.T, strict=True)]),
        np.array([[_share(kind[part], there[part]) for kind in kinds] for part in minutes]),
    )


def _seconds(poses: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Returns the distance in [m] and the turn in [rad] of each robot in each second."""
    stride = min(_SECOND, len(poses) - 1)
    marks = np.arange(0, len(poses), stride)
    heading = np.unwrap(poses[..., 2], axis=0)[marks]
    distance = np.linalg.norm(np.diff(poses[marks, :, :2], axis=0), axis=-1)
    return distance, np.abs(np.diff(heading, axis=0))


def _thirds(kind: np.ndarray, near: np.ndarray) -> tuple[float, float]:
    """Returns the share of a behaviour in the first and last third of a robot's time at the spot.

    For each second, `kind` says whether the robot shows the behaviour, `near` whether it is there.
    """
    there = np.flatnonzero(near)
    third = -(-len(there) // 3)
    first, last = there[:third], there[len(there) - third :]
    return _share(kind[first], near[first]), _share(kind[last], near[last])


def _share(kind: np.ndarray, near: np.ndarray) -> float:
    """Returns the share of the time at the spot with a behaviour; NaN without time at the spot."""
    return float((kind & near).sum() / near.sum()) if near.any() else float("nan")
