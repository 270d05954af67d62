"""Lives as data: phases with their durations, places, worlds, and learning on or off.

The paper's two protocols are lives (sections 3.1 and 3.2). In the lives of the benchmark the world
changes while the robot learns (docs/lives.md).
"""

from __future__ import annotations

import dataclasses
import itertools
import math
import re
from collections.abc import Mapping
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, Literal, get_args

import numpy as np

from ..fields import Checked, choice, flag, number, text
from .episode import CONTROL_TIMESTEP, real_numbers
from .starts import CORNERS, Start, random_poses, random_spots
from .world import World

if TYPE_CHECKING:
    from ..models import Dimensions
    from .batch import Robots
    from .rules import Rules
    from .starts import Random

Stage = Literal["pre", "training", "post"]
STAGES: tuple[Stage, ...] = get_args(Stage)
Unmeasured = Literal["genius", "ignorant"]

UPPER_LEFT, UPPER_RIGHT = CORNERS["upper_left"], CORNERS["upper_right"]
LIFE_NAME = re.compile("[a-z][a-z0-9_]{0,39}(@[1-9][0-9]{0,3})?")
_MOST_LEGS = 100_000
_STEP = CONTROL_TIMESTEP / 60  # minutes of a control step
_LONGEST = 1e6  # minutes of a phase: two years
_NUMBERS = {"robot": 3, "spot": 2}  # in a place


@dataclasses.dataclass(frozen=True)
class Phase(Checked):
    """A part of a life with one world, one rule of placement, and learning on or off.

    Attributes:
      stage: "pre" (test before training), "training" or "post" (test after training).
      minutes: Duration in simulated minutes.
      learning: Whether the robot learns and explores.
      robot: Pose of the robot at the start, x, y in [m] and heading in [rad]; "random" draws it;
        None leaves the robot where it is (in a `Start`, None draws it).
      spot: Centre of the spot at the start, x, y in [m]; "random" draws it; None leaves the spot
        where it is.
      every_minutes: Period in simulated minutes after which robot and spot are placed again; None
        places them once.
      world: Wiring, senses and reward in this phase.
    """

    stage: Stage = choice("training", Stage)
    minutes: float = number(60.0, 0, _LONGEST, unit="minutes")
    learning: bool = flag(True)
    robot: tuple[float, float, float] | Literal["random"] | None = None
    spot: tuple[float, float] | Literal["random"] | None = None
    every_minutes: float | None = number(None, _STEP, _LONGEST, unit="minutes")
    world: World = World()

    def __post_init__(self) -> None:
        """Raises ValueError where a value is not allowed."""
        super().__post_init__()
        if not isinstance(self.world, World):
            raise ValueError(f"world must be a World, got {self.world!r:.60}")
        for name, length in _NUMBERS.items():
            place = getattr(self, name)
            if place is not None and not (isinstance(place, str) and place == "random"):
                what = name if not isinstance(place, str) else f"{name}, unless 'random',"
                place = real_numbers(what, place, (length,), finite=True)
                object.__setattr__(self, name, tuple(place.tolist()))

    def draw(
        self, random: Random, dimensions: Dimensions, robots: int
    ) -> tuple[np.ndarray | None, np.ndarray | None]:
        """Draws the places of the spots, then of the robots, unless they are fixed.

        Returns centres of the spots, shape (B, 2), and poses of the robots, shape (B, 3); None for
        what stays where it is.
        """
        spots = poses = None
        if self.spot == "random":
            spots = random_spots(random, dimensions, robots)
        elif self.spot is not None:
            spots = np.tile(self.spot, (robots, 1))
        if self.robot == "random":
            poses = random_poses(random, dimensions, robots)
        elif self.robot is not None:
            poses = np.tile(self.robot, (robots, 1))
        return spots, poses


@dataclasses.dataclass(frozen=True)
class Leg:
    """A stretch of a life between two placements.

    Attributes:
      start: First control step, counted from 0 at the start of the life.
      stop: First control step after the stretch, counted as `start` is.
      number: Number of the phase in the life, from 0.
      phase: Phase to which the stretch belongs.
      changes_world: Whether the world differs from that of the leg before; False for the first.
    """

    start: int
    stop: int
    number: int
    phase: Phase
    changes_world: bool


@dataclasses.dataclass(frozen=True)
class Life(Checked):
    """A life: one task and its phases, in order.

    Attributes:
      name: Name of the life: lower case letters, digits and underscores.
      title: Title of the life in tables and figures, 1 to 60 characters.
      task: Name of a task of the domain "arena", such as "spot_finding".
      phases: Phases of the life, in the order "pre", "training", "post"; if there are both tests,
        "pre" and "post", they last equally long.
      wanted: True if the measured event is good (in the spot), False if it is bad (in contact);
        decides the sign of Learn Ability.
      unmeasured: Class of a robot for which the measured event holds in neither test: "genius" or
        "ignorant".
    """

    name: str = text("", LIFE_NAME.pattern, "at most 40 lower case letters, digits and underscores")
    title: str = text("", "[^\n]{1,60}", "1 to 60 characters in one line")
    task: str = text("", "[a-z][a-z0-9_]{0,39}", "the name of a task")
    phases: tuple[Phase, ...] = ()
    wanted: bool = flag(True)
    unmeasured: Unmeasured = choice("ignorant", Unmeasured)

    def __post_init__(self) -> None:
        """Raises ValueError where a value is not allowed, phases lack order, or tests differ."""
        super().__post_init__()
        stages = [STAGES.index(phase.stage) for phase in self.phases]
        if not stages or stages != sorted(stages):
            raise ValueError(f"phases must be one or more, ordered by stage: {', '.join(STAGES)}")
        before, after = (
            sum(phase.minutes for phase in self.phases if phase.stage == stage)
            for stage in ("pre", "post")
        )
        if self.tested and not math.isclose(before, after):  # Eq. 4 compares their times
            both = f"{before:.10g} and {after:.10g} min"
            raise ValueError(f"both tests must last equally long, got {both}")
        periods = sum(p.minutes / p.every_minutes for p in self.phases if p.every_minutes)
        if periods > _MOST_LEGS:
            raise ValueError(f"places must be drawn at most {_MOST_LEGS} times, got {periods:.3g}")

    def check(self, rules: Rules, dimensions: Dimensions) -> None:
        """Raises ValueError for an impossible place, or a world that the task does not support.

        Args:
          rules: Rules of the life's task; they say which worlds are possible.
          dimensions: Dimensions of the arena, in which all places must lie.
        """
        if any(phase.robot is None for phase in self.phases):  # one may be lived alone
            Start((0.0, 0.0, 0.0)).check(dimensions)
        for phase in self.phases:
            robot = None if phase.robot == "random" else phase.robot
            spot = None if phase.spot == "random" else phase.spot
            Start(robot, spot).check(dimensions)
            phase.world.rules(rules, dimensions.nose)

    def scaled(self, factor: float) -> Life:
        """Returns the life with all durations times a factor; periods are a step or more."""
        phases = tuple(
            dataclasses.replace(
                phase,
                minutes=phase.minutes * factor,
                every_minutes=phase.every_minutes and max(phase.every_minutes * factor, _STEP),
            )
            for phase in self.phases
        )
        return dataclasses.replace(self, phases=phases)

    def newborn(self, number: int) -> Life:
        """Returns a life that consists of phase `number` alone, counted from 1.

        IndexError where there is no such phase.
        """
        phase = self.phases[number - 1]
        name, title = f"{self.name}@{number}", f"{self.title[:36]}, newborn of phase {number}"
        return dataclasses.replace(self, name=name, title=title, phases=(phase,))

    @property
    def worlds(self) -> tuple[World, ...]:
        """The different worlds, in the order in which they first occur."""
        return tuple(dict.fromkeys(phase.world for phase in self.phases))

    @property
    def tested(self) -> bool:
        """Whether the life has tests before and after training, which Learn Ability compares."""
        return {"pre", "post"} <= {phase.stage for phase in self.phases}

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

        In a short life, two stages may share a minute, which is then in both slices.
        """
        first = sum(self.steps_of(before) for before in STAGES[: STAGES.index(stage)])
        last, minute = first + self.steps_of(stage), control_steps(1)
        return slice(first // minute, -(-last // minute))

    def legs(self) -> list[Leg]:
        """Returns the stretches of the life between two placements, in order."""
        legs = []
        now = 0
        for index, (phase, length) in enumerate(zip(self.phases, self.steps(), strict=True)):
            end = now + length
            period = control_steps(phase.every_minutes) if phase.every_minutes else length
            while now < end:
                changes = bool(legs) and legs[-1].phase.world != phase.world
                legs.append(Leg(now, min(now + period, end), index, phase, changes))
                now = legs[-1].stop
        return legs

    @property
    def event(self) -> str:
        """The measured event, in words."""
        if any(world.rewarded != "task" for world in self.worlds):
            return "at the goal"
        return "in the spot" if self.wanted else "in contact"


def place(batch: Robots, phase: Phase, random: Random, robots: np.ndarray | None = None) -> None:
    """Enters a phase's world, and places spots, then robots, which sense the new spots.

    `robots` are the indices of those that are placed, shape (n,); None for all.
    """
    batch.enter(phase.world)
    placed = np.arange(batch.robots) if robots is None else robots
    spots, poses = phase.draw(random, batch.dimensions, len(placed))
    if spots is not None:
        batch.place_spot(placed, spots)
    if poses is not None:
        batch.place(placed, poses)


def control_steps(minutes: float) -> int:
    """Converts simulated minutes to control steps, rounded to the nearest, at least one."""
    return max(1, round(minutes * 60 / CONTROL_TIMESTEP))


# ---- The paper's lives ----


def _tests(stage: Stage) -> tuple[Phase, ...]:
    return tuple(Phase(stage, 10, False, robot=corner) for corner in (UPPER_LEFT, UPPER_RIGHT))


def _search(stage: Stage) -> Phase:
    return Phase(stage, 60, False, robot=UPPER_LEFT, spot=UPPER_RIGHT[:2])


WALL_AVOIDANCE = Life(
    "wall_avoidance",
    "Wall avoidance",
    "wall_avoidance",
    (
        *_tests("pre"),
        Phase("training", 120, True, robot="random", every_minutes=5),
        *_tests("post"),
    ),
    wanted=False,
    unmeasured="genius",
)

SPOT_FINDING = Life(
    "spot_finding",
    "Spot finding",
    "spot_finding",
    (
        _search("pre"),
        Phase("training", 240, True, spot="random", every_minutes=60),
        _search("post"),
    ),
)

# Beyond the paper: the robot also senses walls, and the reward is 0 in contact.
WALLS_SENSED = dataclasses.replace(
    SPOT_FINDING, name="spot_finding_walls", title="Spot finding, walls sensed",
    task="spot_finding_walls",
)  # fmt: skip

PAPER_LIVES = (WALL_AVOIDANCE.name, SPOT_FINDING.name)


# ---- Lives that change: no policy is good in all worlds of such a life (docs/lives.md) ----

_HOURS = 12
_TURNS = 120  # rotations of the wiring in the life `drift`: 3 degrees every 6 minutes


def _changing(name: str, title: str, worlds: list[World], task: str = "spot_finding") -> Life:
    """Returns a life of 12 hours in which worlds take turns; the spot moves every two minutes.

    The robot starts in the middle of the arena and is never placed again.
    """
    minutes = _HOURS * 60 / len(worlds)
    phases = (Phase(minutes=minutes, spot="random", every_minutes=2, world=one) for one in worlds)
    return Life(name, title, task, tuple(phases))


def _turned(angle: float) -> World:
    """Returns a world that rotates the pair of motor values by an angle in [rad]."""
    cosine, sine = math.cos(angle), math.sin(angle)
    return World(wheels=(cosine, sine, -sine, cosine))


_LEFT_REVERSED, _NOSE_BEHIND = World(wheels=(-1.0, 0.0, 0.0, 1.0)), World(nose=180.0)
_NOSE_INVERTED, _DRIVING = World(sensors=(("nose", 1.0, -1.0),)), World(rewarded="driving")

BODY = _changing("body", "Changing body", [World(), _LEFT_REVERSED, _NOSE_BEHIND] * 4)
DRIFT = _changing(
    "drift", "Drifting body", [_turned(2 * math.pi * turn / _TURNS) for turn in range(_TURNS)]
)
CHANGING_TASK = _changing("tasks", "Changing task", [World(), _DRIVING] * 6, "spot_or_driving")
SENSES = _changing("senses", "Changing senses", [World(), _NOSE_INVERTED] * 6)

CHANGING = (BODY, DRIFT, CHANGING_TASK, SENSES)
LIVES: Mapping[str, Life] = MappingProxyType(
    {life.name: life for life in (WALL_AVOIDANCE, SPOT_FINDING, WALLS_SENSED, *CHANGING)}
)


def life_named(name: str, lives: Mapping[str, Life] = LIVES) -> Life:
    """Returns a life by its name; NAME@K is phase K alone, from 1. KeyError if there is none."""
    name, at, number = name.partition("@")
    if not at:
        return lives[name]
    if not number.isdecimal() or not 1 <= int(number) <= len(lives[name].phases):
        raise KeyError(f"{name}@{number}")
    return lives[name].newborn(int(number))


# ---- Users' own lives ----


def life_from(fields: Any) -> Life:
    """Returns the life whose fields were read from TOML or JSON.

    Raises ValueError where a field is unknown or missing, or a value is not allowed.
    """
    own = _known(fields, Life, "a life")
    if not isinstance(own.get("phases"), list | tuple) or not own["phases"]:
        raise ValueError("a life must have a list of phases, [[phases]]")
    if missing := {"name", "task"} - {*own}:
        raise ValueError(f"a life must have a {min(missing)}")
    if "@" in str(own["name"]):
        raise ValueError(f"a name with @ is that of a newborn's life, got {own['name']!r:.60}")
    own["phases"] = tuple(map(_phase_from, own["phases"], itertools.count(1)))
    return Life(**{"title": own["name"], **own})


def _phase_from(fields: Any, number: int) -> Phase:
    try:
        own = _known(fields, Phase, "a phase")
        if "world" in own:
            own["world"] = World(**_known(own["world"], World, "a world"))
        return Phase(**own)
    except ValueError as error:
        raise ValueError(f"phase {number}: {error}") from error


def _known(fields: Any, cls: type, what: str) -> dict[str, Any]:
    """Returns fields by name; ValueError for a name that is no field of `cls`."""
    names = [field.name for field in dataclasses.fields(cls)]
    if not isinstance(fields, Mapping):
        raise ValueError(f"{what} must have names with values, got {fields!r:.60}")
    for name in fields:
        if name not in names:
            raise ValueError(f"{what} has the fields {', '.join(names)}, got {name!r:.60}")
    return dict(fields)
