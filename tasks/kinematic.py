"""Robots in lockstep on the kinematic stand-in instead of MuJoCo: same rules, same interface."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ..models import Dimensions, Kinematics, hide_spot
from ..models.kinematic import catch_up, distances, drive, gaps, seen_from_nose
from .arena import CONTROL_TIMESTEP, Rules
from .batch import Robots
from .sensors import NoseForm
from .suite import Edit, row_of


class KinematicBatch(Robots):
    """B ideal differential drives, each alone in its own arena (see `models.kinematic`)."""

    def __init__(
        self,
        dimensions: Dimensions,
        rules: Rules,
        nsensordata: int,
        robots: int,
        kinematics: Kinematics,
    ) -> None:
        """Makes B robots, all at the origin.

        Args:
          dimensions: of the MuJoCo arena that this one stands in for.
          rules: of the task, for that arena.
          nsensordata: numbers that MuJoCo measures there.
          robots: B.
          kinematics: how they drive.

        Raises:
          ValueError: robots is not positive.
        """
        super().__init__(robots, rules, kinematics.applied_to(dimensions), nsensordata)
        self._kinematics = kinematics
        self._poses = np.zeros((robots, 3))
        self._spots = np.zeros((robots, 2))
        self._wheels = np.zeros((robots, 2))  # how fast they turn, in motor values
        self._touch = np.zeros(robots)
        self._sense()

    @property
    def pose(self) -> np.ndarray:
        """See `Robots.pose`."""
        return self._poses.copy()

    @property
    def spot(self) -> np.ndarray:
        """See `Robots.spot`."""
        return self._spots.copy()

    def place(self, robots: np.ndarray, poses: np.ndarray) -> None:
        """See `Robots.place`."""
        self._poses[robots] = poses
        self._wheels[robots] = 0
        self._touch[robots] = self._near()[robots] if self._kinematics.felt == "near" else 0
        others = np.delete(np.arange(self.robots), robots)
        before = self.sensordata[others].copy()
        self._sense()
        self.sensordata[others] = before

    def place_spot(self, robots: np.ndarray, spots: np.ndarray) -> None:
        """See `Robots.place_spot`."""
        self._spots[robots] = spots

    def step(self, motors: np.ndarray) -> None:
        """See `Robots.step`."""
        motors = np.clip(self._sound(motors), -0.5, 0.5)
        how, contact = self._kinematics, np.zeros(self.robots, dtype=bool)
        piece = CONTROL_TIMESTEP / how.pieces
        for _ in range(how.pieces):
            speeds, self._wheels[:] = catch_up(self._wheels, motors, piece, how.lag)
            self._poses, pushing = drive(self._poses, speeds, piece, how.wall, self.dimensions)
            felt = pushing if how.felt == "pushed" else self._near()
            contact = (contact | felt) if how.any_contact else felt
        self._touch[:] = contact
        self._sense()

    def arrays(self) -> dict[str, np.ndarray]:
        """See `Robots.arrays`."""
        return {
            "poses": self._poses,
            "spots": self._spots,
            "wheels": self._wheels,
            "touch": self._touch,
            "sensordata": self.sensordata,
            "valid": self.valid,
        }

    def _near(self) -> np.ndarray:
        return gaps(self._poses, self.dimensions) <= self.dimensions.contact_margin

    def _sense(self) -> None:
        layout = self.rules.layout
        nose = seen_from_nose(self._poses, self._spots, self.dimensions)
        self.sensordata[:, layout.distances] = distances(self._poses, self.dimensions)
        self.sensordata[:, layout.touch] = self._touch[:, None]
        self.sensordata[:, layout.smell.start : layout.smell.start + 2] = nose
        self.sensordata[~self.valid] = 0


def make_kinematic_batch(
    task_name: str,
    robots: int,
    kinematics: Kinematics,
    *,
    nose: NoseForm = "inverse",
    motor_speed: float | None = None,
    edits: Sequence[Edit] = (),
) -> KinematicBatch:
    """Returns robots in lockstep on the stand-in, for a task with the paper's robot and arena.

    Args:
      task_name: of the table, without pillars, a second nose or a sense of velocity.
      robots: how many.
      kinematics: how they drive.
      nose: the form of Eq. 3.
      motor_speed: see `make_batch`.
      edits: see `make_batch`.

    Raises:
      ValueError: there is no such task, the stand-in cannot have it, or a number makes no sense.
    """
    row = row_of(task_name)
    if not {hide_spot}.issuperset(row.edits):
        raise ValueError(f"the kinematic stand-in knows only the paper's arena, not {task_name!r}")
    model = row.spec(motor_speed, edits).compile()
    rules = row.rules.of(model, nose)
    return KinematicBatch(Dimensions.of(model), rules, model.nsensordata, robots, kinematics)
