"""Schedules as data: phases, placements, minutes, learning on or off (sections 3.1 and 3.2)."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Mapping
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, Literal, get_args

import numpy as np

from ...tasks.arena import CONTROL_TIMESTEP
from ...tasks.starts import CORNERS, random_poses, random_spots

if TYPE_CHECKING:
    from ...tasks.batch import Robots

TASK_NAMES = {"wall_avoidance": "Wall avoidance", "spot_finding": "Spot finding"}

Stage = Literal["pre", "training", "post"]
STAGES: tuple[Stage, ...] = get_args(Stage)
ProtocolName = Literal["paper", "walls"]

UPPER_LEFT, UPPER_RIGHT = CORNERS["upper_left"], CORNERS["upper_right"]


@dataclasses.dataclass(frozen=True)
class Phase:
    """A stretch of a life with one rule of placement and learning.

    Attributes:
      stage: "pre" or "post", the tests before and after training, or "training".
      minutes: Duration in simulated minutes.
      learning: Whether the robot learns and explores.
      robot: Pose of the robot at the start, x, y in [m] and heading in [rad]; "random" draws it;
        None leaves the robot where it is.
      spot: Centre of the spot at the start, x, y in [m]; "random" draws it; None leaves the spot
        where it is.
      every_minutes: Period in simulated minutes after which robot and spot are placed again; None
        places them once.
    """

    stage: Stage
    minutes: float
    learning: bool
    robot: tuple[float, float, float] | Literal["random"] | None = None
    spot: tuple[float, float] | Literal["random"] | None = None
    every_minutes: float | None = None


@dataclasses.dataclass(frozen=True)
class Leg:
    """A stretch of a life between two placements, from control step `start` to `stop`."""

    start: int
    stop: int
    phase: Phase


@dataclasses.dataclass(frozen=True)
class Schedule:
    """A life: one task and its phases, in order.

    Attributes:
      task: Task of the domain "arena".
      phases: Phases of the life, in order.
      wanted: True if the measured event is good (in the spot), False if it is bad (in contact);
        decides the sign of Learn Ability.
      unmeasured: Class of a robot for which the event happens in neither test.
    """

    task: str
    phases: tuple[Phase, ...]
    wanted: bool
    unmeasured: Literal["genius", "ignorant"]

    def scaled(self, factor: float) -> Schedule:
        """Returns the schedule with every duration multiplied by a factor."""
        return self._changed(
            lambda phase: {
                "minutes": phase.minutes * factor,
                "every_minutes": phase.every_minutes and phase.every_minutes * factor,
            }
        )

    def moved(self, x: float, y: float, angle: float) -> Schedule:
        """Returns the schedule with other fixed places.

        Args:
          x: Distance in [m] by which places move away from the centre along x.
          y: Distance in [m] by which places move away from the centre along y.
          angle: Angle in [rad] by which poses of the robot are turned.
        """

        def moved(place: Any) -> Any:
            if not isinstance(place, tuple):
                return place
            away = place[0] + math.copysign(x, place[0]), place[1] + math.copysign(y, place[1])
            return (*away, *(heading + angle for heading in place[2:]))

        return self._changed(lambda phase: {"robot": moved(phase.robot), "spot": moved(phase.spot)})

    def steps(self) -> list[int]:
        """Returns the number of control steps of each phase, at least one."""
        return [control_steps(phase.minutes) for phase in self.phases]

    def steps_of(self, stage: Stage) -> int:
        """Returns the number of control steps of a stage of the life."""
        pairs = zip(self.phases, self.steps(), strict=True)
        return sum(steps for phase, steps in pairs if phase.stage == stage)

    def steps_of_minutes(self) -> np.ndarray:
        """Returns the number of control steps of each simulated minute of a life, shape (M,)."""
        total, minute = sum(self.steps()), control_steps(1)
        steps = np.full(-(-total // minute), minute)
        steps[-1] = total - steps[:-1].sum()
        return steps

    def minutes_of(self, stage: Stage) -> slice:
        """Returns a slice: the stage's minutes in a curve with one value per minute of the life.

        With a small time scale two stages may share a minute, which then is in both.
        """
        first = sum(self.steps_of(before) for before in STAGES[: STAGES.index(stage)])
        last, minute = first + self.steps_of(stage), control_steps(1)
        return slice(first // minute, -(-last // minute))

    def legs(self) -> list[Leg]:
        """Returns the stretches of the life between two placements, in order."""
        legs = []
        now = 0
        for phase, length in zip(self.phases, self.steps(), strict=True):
            end = now + length
            period = control_steps(phase.every_minutes) if phase.every_minutes else length
            while now < end:
                legs.append(Leg(now, min(now + period, end), phase))
                now = legs[-1].stop
        return legs

    @property
    def event(self) -> str:
        """The measured event, in words."""
        return "in the spot" if self.wanted else "in contact"

    def _changed(self, fields: Callable[[Phase], dict[str, Any]]) -> Schedule:
        """Returns the schedule with some fields of every phase replaced."""
        phases = tuple(dataclasses.replace(phase, **fields(phase)) for phase in self.phases)
        return dataclasses.replace(self, phases=phases)


def control_steps(minutes: float) -> int:
    """Converts simulated minutes to control steps, rounded to the nearest, at least one."""
    return max(1, round(minutes * 60 / CONTROL_TIMESTEP))


def place(batch: Robots, phase: Phase, random: np.random.Generator) -> None:
    """Places spots, then robots, as a phase begins; in this order robots sense the new spots.

    Args:
      batch: Robots to place.
      phase: Phase that defines the places.
      random: Random stream from which random places are drawn.
    """
    everyone = np.arange(batch.robots)
    if phase.spot == "random":
        batch.place_spot(everyone, random_spots(random, batch.dimensions, batch.robots))
    elif phase.spot is not None:
        batch.place_spot(everyone, np.tile(phase.spot, (batch.robots, 1)))
    if phase.robot == "random":
        batch.place(everyone, random_poses(random, batch.dimensions, batch.robots))
    elif phase.robot is not None:
        batch.place(everyone, np.tile(phase.robot, (batch.robots, 1)))


def _tests(stage: Stage) -> tuple[Phase, ...]:
    return tuple(Phase(stage, 10, False, robot=corner) for corner in (UPPER_LEFT, UPPER_RIGHT))


def _search(stage: Stage) -> Phase:
    return Phase(stage, 60, False, robot=UPPER_LEFT, spot=UPPER_RIGHT[:2])


WALL_AVOIDANCE = Schedule(
    task="wall_avoidance",
    phases=(
        *_tests("pre"),
        Phase("training", 120, True, robot="random", every_minutes=5),
        *_tests("post"),
    ),
    wanted=False,
    unmeasured="genius",
)

SPOT_FINDING = Schedule(
    task="spot_finding",
    phases=(
        _search("pre"),
        Phase("training", 240, True, spot="random", every_minutes=60),
        _search("post"),
    ),
    wanted=True,
    unmeasured="ignorant",
)

# Beyond the paper: the robot also senses walls, and the reward is 0 in contact.
WALLS_SENSED = dataclasses.replace(SPOT_FINDING, task="spot_finding_walls")

SCHEDULES = {schedule.task: schedule for schedule in (WALL_AVOIDANCE, SPOT_FINDING)}
PROTOCOLS: Mapping[ProtocolName, Mapping[str, Schedule]] = MappingProxyType(
    {"paper": SCHEDULES, "walls": {SPOT_FINDING.task: WALLS_SENSED}}
)
