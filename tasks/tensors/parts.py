"""Robots on tensors that several groups share, so that one call simulates them all."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NoReturn

import numpy as np

from ..batch import Robots, copy_arrays
from .robots import TensorRobots


class Part(Robots):
    """Some of the robots of a larger batch, which takes their steps; see `parts`.

    Attributes:
      whole: The larger batch.
      rows: Rows of its arrays that are these robots'.
    """

    def __init__(self, whole: TensorRobots, first: int, robots: int) -> None:
        """Takes robots first to first + robots - 1 of a batch."""
        super().__init__(robots, whole.rules, whole.dimensions, whole.sensordata.shape[1])
        self.whole = whole
        self.rows = slice(first, first + robots)
        self.sensordata: Any = whole.sensordata[self.rows]
        self.valid: Any = whole.valid[self.rows]

    @property
    def pose(self) -> np.ndarray:
        """See `Robots.pose`."""
        return self.whole.pose[self.rows]

    @property
    def spot(self) -> np.ndarray:
        """See `Robots.spot`."""
        return self.whole.spot[self.rows]

    def place(self, robots: np.ndarray, poses: np.ndarray) -> None:
        """See `Robots.place`."""
        robots, poses = self._placed(robots, poses, "poses", 3)
        self.whole.place(robots + self.rows.start, poses)

    def place_spot(self, robots: np.ndarray, spots: np.ndarray) -> None:
        """See `Robots.place_spot`."""
        robots, spots = self._placed(robots, spots, "spots", 2)
        self.whole.place_spot(robots + self.rows.start, spots)

    def stop(self, robots: np.ndarray) -> None:
        """See `Robots.stop`."""
        self.whole.stop(np.arange(self.robots)[robots] + self.rows.start)

    def step(self, motors: Any) -> NoReturn:
        """Raises TypeError: only the larger batch can take a step."""
        raise TypeError("a part takes no step of its own: `whole.step` is that of all parts")

    def arrays(self) -> dict[str, np.ndarray]:
        """See `Robots.arrays`; copies on the host."""
        return {name: array[self.rows] for name, array in self.whole.arrays().items()}

    def load_arrays(self, arrays: Mapping[str, np.ndarray]) -> None:
        """See `Robots.load_arrays`."""
        whole = self.whole.arrays()
        own = {name: array[self.rows] for name, array in whole.items()}
        copy_arrays(arrays, own)
        self.whole.load_arrays(whole)


def parts(whole: TensorRobots, count: int) -> list[Part]:
    """Returns a batch as so many parts of equal size.

    Raises:
      ValueError: the number of robots is no multiple of the number of parts.
    """
    robots, left = divmod(whole.robots, count)
    if left:
        raise ValueError(f"{whole.robots} robots cannot be {count} equal parts")
    return [Part(whole, k * robots, robots) for k in range(count)]
