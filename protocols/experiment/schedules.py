"""The experiments as data: who is placed where, for how long, learning or not (section 3).

The paper's two, and two beyond them.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from types import MappingProxyType
from typing import Literal, get_args

from ...tasks import CONTROL_TIMESTEP
from ...tasks.starts import CORNERS

NAMES = {"wall_avoidance": "Wall avoidance", "spot_finding": "Spot finding"}

Part = Literal["pre", "training", "post"]
PARTS: tuple[Part, ...] = get_args(Part)
Course = Literal["paper", "day", "walls"]

UPPER_LEFT, UPPER_RIGHT = CORNERS["upper_left"], CORNERS["upper_right"]


@dataclasses.dataclass(frozen=True)
class Phase:
    """A stretch of a life under one regime.

    Attributes:
      part: of the life: "pre" and "post" are measured, "training" is not.
      minutes: how long, in simulated minutes.
      learning: whether the robot learns, and explores.
      robot: where it is placed at the start: x, y in metres and heading in radians; "random"
        draws a pose; None leaves it where it is.
      spot: where the odorous spot is put at the start: x, y in metres; "random" draws a
        place; None leaves it where it is.
      every_minutes: robot and spot are placed as at the start again and again, after so many
        simulated minutes; None places them once.
    """

    part: Part
    minutes: float
    learning: bool
    robot: tuple[float, float, float] | Literal["random"] | None = None
    spot: tuple[float, float] | Literal["random"] | None = None
    every_minutes: float | None = None


@dataclasses.dataclass(frozen=True)
class Schedule:
    """A life: one task and its phases, in order.

    Attributes:
      task: of the domain "arena", in which it is lived.
      phases: in order.
      wanted: whether the measured event is good (in the spot) or bad (in contact), the sign
        of Learn Ability.
      unmeasured: what a robot is called that never met the event in either test.
    """

    task: str
    phases: tuple[Phase, ...]
    wanted: bool
    unmeasured: Literal["genius", "ignorant"]

    def scaled(self, factor: float) -> Schedule:
        """Returns the schedule with every duration times a factor."""
        return dataclasses.replace(
            self,
            phases=tuple(
                dataclasses.replace(
                    phase,
                    minutes=phase.minutes * factor,
                    every_minutes=phase.every_minutes and phase.every_minutes * factor,
                )
                for phase in self.phases
            ),
        )

    def turned(self, angle: float) -> Schedule:
        """Returns the schedule with every robot that is put at a fixed place turned by radians."""
        return dataclasses.replace(
            self,
            phases=tuple(
                dataclasses.replace(phase, robot=(*phase.robot[:2], phase.robot[2] + angle))
                if isinstance(phase.robot, tuple)
                else phase
                for phase in self.phases
            ),
        )

    def steps(self) -> list[int]:
        """Control steps of each phase, at least one."""
        return [control_steps(phase.minutes) for phase in self.phases]

    def steps_of(self, part: Part) -> int:
        """Control steps of a part of the life."""
        pairs = zip(self.phases, self.steps(), strict=True)
        return sum(steps for phase, steps in pairs if phase.part == part)

    def minutes_of(self, part: Part) -> slice:
        """Where a part of the life lies in a curve with a value a minute.

        In a rehearsal parts may share a minute, which then is in both.
        """
        first = sum(self.steps_of(before) for before in PARTS[: PARTS.index(part)])
        last, minute = first + self.steps_of(part), control_steps(1)
        return slice(first // minute, -(-last // minute))

    @property
    def event(self) -> str:
        """What is measured, in words."""
        return "in the spot" if self.wanted else "in contact"


def control_steps(minutes: float) -> int:
    """Simulated minutes in control steps, to the nearest, at least one."""
    return max(1, round(minutes * 60 / CONTROL_TIMESTEP))


def _tests(part: Part) -> tuple[Phase, ...]:
    return tuple(Phase(part, 10, False, robot=corner) for corner in (UPPER_LEFT, UPPER_RIGHT))


def _search(part: Part) -> Phase:
    return Phase(part, 60, False, robot=UPPER_LEFT, spot=UPPER_RIGHT[:2])


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

# Beyond the paper: is a spot found again and again, for a whole day of learning?
DAY = dataclasses.replace(
    SPOT_FINDING,
    phases=(
        _search("pre"),
        Phase("training", 1440, True, spot="random", every_minutes=10),
        _search("post"),
    ),
)

# Beyond the paper: is a spot found by a robot that has its walls to think of, too?
WALLS = dataclasses.replace(SPOT_FINDING, task="spot_finding_walls")

SCHEDULES = {schedule.task: schedule for schedule in (WALL_AVOIDANCE, SPOT_FINDING)}
COURSES: Mapping[Course, Mapping[str, Schedule]] = MappingProxyType(
    {
        "paper": SCHEDULES,
        "day": {SPOT_FINDING.task: DAY},
        "walls": {SPOT_FINDING.task: WALLS},
    }
)
