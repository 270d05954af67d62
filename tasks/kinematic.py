"""Robots in lockstep in the kinematic simulator, with the interface of `batch.Batch`."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ..models import ARENA_XML, Dimensions, Kinematics, hide_spot
from ..models.kinematic import distances, drive, follow_motors, gaps, spot_from_nose
from .arena import CONTROL_TIMESTEP, Edit
from .batch import Robots
from .rules import Rules
from .sensors import NoseForm
from .suite import task_definition


class KinematicBatch(Robots):
    """B ideal differential drives, each alone in its arena (see `models.kinematic`)."""

    def __init__(
        self,
        dimensions: Dimensions,
        rules: Rules,
        nsensordata: int,
        robots: int,
        kinematics: Kinematics,
    ) -> None:
        """Places B robots at the origin.

        Args:
          dimensions: Dimensions of the arena's MuJoCo model.
          rules: Rules of the task for that model.
          nsensordata: Number of values in that model's `sensordata`.
          robots: Number of robots, B.
          kinematics: Settings of the kinematic simulator.

        Raises:
          ValueError: robots is below 1.
        """
        super().__init__(robots, rules, kinematics.applied_to(dimensions), nsensordata)
        self._kinematics = kinematics
        self._gains = np.array(self.dimensions.gains, dtype=np.float32)
        self._poses = np.zeros((robots, 3))
        self._spots = np.zeros((robots, 2))
        self._wheels = np.zeros((robots, 2))  # speeds of the wheels, in motor values
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
        robots, poses = self._placed(robots, poses, "poses", 3)
        inside = self.dimensions.sound(poses[:, :2]).all(axis=1)
        sound = inside & np.isfinite(poses[:, 2])
        self.valid[robots[~sound]] = False
        self._poses[robots] = np.where(sound[:, None], poses, 0.0)
        self._wheels[robots] = 0
        self._touch[robots] = self._near()[robots] if self._kinematics.felt == "near" else 0
        others = np.delete(np.arange(self.robots), robots)
        before = self.sensordata[others].copy()
        self._sense()
        self.sensordata[others] = before

    def place_spot(self, robots: np.ndarray, spots: np.ndarray) -> None:
        """See `Robots.place_spot`."""
        robots, spots = self._placed(robots, spots, "spots", 2)
        self._spots[robots] = spots

    def step(self, motors: np.ndarray) -> None:
        """See `Robots.step`."""
        motors = np.clip(self._finite_motors(motors), -0.5, 0.5) * self._gains
        how, contact = self._kinematics, np.zeros(self.robots, dtype=bool)
        piece = CONTROL_TIMESTEP / how.pieces
        for _ in range(how.pieces):
            speeds, self._wheels[:] = follow_motors(self._wheels, motors, piece, how.lag)
            self._poses, pushing = drive(self._poses, speeds, piece, how, self.dimensions)
            felt = pushing if how.felt == "pushed" else self._near()
            contact = (contact | felt) if how.any_contact else felt
        self._touch[:] = contact
        self._sense()
        self._stop_unsound(self.dimensions.sound(self._poses[:, :2]))

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
        spot = spot_from_nose(self._poses, self._spots, self.dimensions)
        self.sensordata[:, layout.distances] = distances(self._poses, self.dimensions)
        self.sensordata[:, layout.touch] = self._touch[:, None]
        self.sensordata[:, layout.smell.start : layout.smell.start + 2] = spot
        if not self.valid.all():
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
    """Returns robots in lockstep in the kinematic simulator, with a task's sensors.

    Args:
      task_name: Name of a task whose robot and arena are the paper's: no pillars, no second
        nose, no sense of velocity.
      robots: Number of robots.
      kinematics: Settings of the kinematic simulator.
      nose: Form of Eq. 3.
      motor_speed: Speed of a wheel at motor value 0.5 in [m/s]; None for that of the model.
      edits: Further edits of the arena's model, after the task's own.

    Raises:
      ValueError: There is no such task, its arena is not the paper's, or a value is out of range.
    """
    definition = task_definition(task_name)
    if definition.model != ARENA_XML or not {hide_spot}.issuperset(definition.edits):
        raise ValueError(
            f"a task of the kinematic simulator must have the paper's arena, got {task_name!r}"
        )
    model = definition.spec(motor_speed, edits).compile()
    rules = definition.rules.of(model, nose)
    return KinematicBatch(Dimensions.of(model), rules, model.nsensordata, robots, kinematics)
