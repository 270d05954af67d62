"""Sensor signals of the paper: pure, vectorised functions of what MuJoCo measures.

The dm_control tasks and the batches of robots all call them; only `compiled_equations.py` repeats
Eq. 2 and Eq. 3, for Numba. They take arrays of NumPy, or tensors of PyTorch on any device, and
return the same kind.
"""

from __future__ import annotations

import dataclasses
import math
from typing import Any, Literal

import numpy as np

from ..fields import Checked, choice, number
from ..models.arrays import as_numbers, at_least, namespace, replaced

NoseForm = Literal["inverse", "printed"]


def distance_signal(distance: np.ndarray) -> np.ndarray:
    """Returns Eq. 2, s = 1 / (1 + d)^10, for d of any shape: 1 at a wall, 0 far from everything.

    The distance d to the nearest obstacle is in [m]. A negative d, MuJoCo's value for a ray that
    hits nothing, gives 0.
    """
    # (1 + d)^10 by four products: ten times faster than a power, and identical on every machine.
    base = 1.0 + at_least(distance, 0.0)
    square = base * base
    fourth = square * square
    return replaced(1.0 / (fourth * fourth * square), distance < 0, 0.0)


def contact_signal(force: np.ndarray) -> np.ndarray:
    """Returns -1.0 in contact, else 0.0 (section 3), for a force in [N] of any shape."""
    return 0.0 - as_numbers(force > 0, force.dtype)


@dataclasses.dataclass(frozen=True)
class Nose(Checked):
    """The nose of section 3, with its Eq. 3.

    Attributes:
      odour: Amount of odour o of the spot (Eq. 3) in [mol].
      frustum: Opening angle alpha of the nose in [rad]; it smells up to alpha / 2 to each side.
      spot_radius: Radius r of the odorous spot, in [m].
      form: "inverse": the raw signal falls with the distance, as r/d, so that it is highest in
        the spot. "printed": Eq. 3 as printed, d/r, which grows with the distance
        (docs/paper.md).
    """

    odour: float = number(10.0, 0, math.inf, "()", unit="mol")
    frustum: float = number(np.pi / 2, 0, math.inf, "()", unit="rad")
    spot_radius: float = number(0.06, 0, math.inf, "()", unit="m")
    form: NoseForm = choice("inverse", NoseForm)

    def inside(self, spot: np.ndarray) -> np.ndarray:
        """Returns whether the nose is inside the spot (d < r), shape (...); see `signal`."""
        return _distance(namespace(spot), spot) < self.spot_radius

    def signal(self, spot: np.ndarray) -> np.ndarray:
        """Returns Eq. 3, s = s' / (1 + s') with s' = o (r/d) (1 - 2 beta / alpha).

        In the form "printed", r/d is d/r.

        Args:
          spot: Spot's centre in the frame of the nose: ahead, left (and up, unused), in [m],
            shape (..., 2 or 3).

        Returns:
          Signal in [0, 1), shape (...). Inside the spot: o / (1 + o) in every direction. Outside:
          0 if the spot's centre is more than alpha / 2 off the front.
        """
        xp = namespace(spot)
        distance = _distance(xp, spot)
        beta = xp.abs(xp.atan2(spot[..., 1], spot[..., 0]))
        # Inside the spot the distance is not used: the maximum only avoids a division by 0.
        ratio = self.spot_radius / at_least(distance, self.spot_radius)
        if self.form == "printed":
            ratio = 1.0 / ratio
        raw = self.odour * ratio * at_least(1.0 - 2.0 * beta / self.frustum, 0.0)
        raw = replaced(raw, distance < self.spot_radius, self.odour)
        return raw / (1.0 + raw)


def _distance(xp: Any, spot: np.ndarray) -> np.ndarray:
    return xp.sqrt(spot[..., 0] * spot[..., 0] + spot[..., 1] * spot[..., 1])
