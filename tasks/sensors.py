"""What the robot senses: pure, vectorised functions from what MuJoCo measures to signals.

The dm_control tasks and the batch of robots both call these; there is no other definition.
"""

from __future__ import annotations

import dataclasses
from typing import Literal

import numpy as np

NoseForm = Literal["inverse", "printed"]


def distance_signal(distance: np.ndarray) -> np.ndarray:
    """Eq. 2 of the paper, s = 1 / (1 + d)^10: 1 at a wall, 0 far from everything.

    Args:
      distance: from the sensor to the nearest obstacle, in metres, any shape; negative where
        the ray meets nothing, as a MuJoCo rangefinder reports it.

    Returns:
      The signal, in [0, 1], of the same shape; 0 where the ray meets nothing.
    """
    # (1 + d)^10 by four products: ten times faster than a power, and the same everywhere.
    base = 1.0 + np.maximum(distance, 0.0)
    square = base * base
    fourth = square * square
    return np.where(distance < 0, 0.0, 1.0 / (fourth * fourth * square))


def contact_signal(force: np.ndarray) -> np.ndarray:
    """Section 3: -1 while the robot touches something, else 0.

    Args:
      force: the touch sensor's, in newton, any shape.

    Returns:
      The signal, -1.0 or 0.0, of the same shape.
    """
    return np.where(force > 0, -1.0, 0.0)


@dataclasses.dataclass(frozen=True)
class Nose:
    """The nose of section 3, and its Eq. 3.

    Attributes:
      odour: o, the "amount of odour" of the spot, in mol.
      frustum: alpha, the angle within which the nose smells, in radians.
      spot_radius: r, of the odorous spot, in metres.
      form: "inverse" takes the raw signal to fall with the distance, as r/d, which the
        paper's text and results ask for; "printed" takes Eq. 3 as printed, d/r, with which
        the odour grows with the distance. See docs/paper.md.
    """

    odour: float = 10.0
    frustum: float = np.pi / 2
    spot_radius: float = 0.06
    form: NoseForm = "inverse"

    def __post_init__(self) -> None:
        if self.form not in ("inverse", "printed"):
            raise ValueError(f"form must be 'inverse' or 'printed', got {self.form!r}")
        for name in ("odour", "frustum", "spot_radius"):
            if not getattr(self, name) > 0:
                raise ValueError(f"{name} must be positive, got {getattr(self, name)}")

    def inside(self, spot: np.ndarray) -> np.ndarray:
        """Whether the nose is inside the spot, d < r.

        Args:
          spot: the spot's centre in the frame of the nose: ahead, to the left (and up, not
            looked at), in metres, shape (..., 2 or 3).

        Returns:
          Booleans, shape (...).
        """
        return _distance(spot) < self.spot_radius

    def signal(self, spot: np.ndarray) -> np.ndarray:
        """Eq. 3, s = s' / (1 + s') with s' = o (r/d) (1 - 2 beta / alpha) in front.

        Args:
          spot: the spot's centre in the frame of the nose: ahead, to the left (and up, not
            looked at), in metres, shape (..., 2 or 3).

        Returns:
          The signal, in [0, 1), shape (...): o / (1 + o) inside the spot, whatever its
          direction; 0 outside, where it lies more than alpha / 2 off the front.
        """
        distance = _distance(spot)
        beta = np.abs(np.arctan2(spot[..., 1], spot[..., 0]))
        # Inside, distance plays no part: the maximum only keeps 0 out of the division.
        ratio = self.spot_radius / np.maximum(distance, self.spot_radius)
        if self.form == "printed":
            ratio = 1.0 / ratio
        raw = self.odour * ratio * np.maximum(1.0 - 2.0 * beta / self.frustum, 0.0)
        raw = np.where(distance < self.spot_radius, self.odour, raw)
        return raw / (1.0 + raw)


def _distance(spot: np.ndarray) -> np.ndarray:
    return np.sqrt(spot[..., 0] * spot[..., 0] + spot[..., 1] * spot[..., 1])
