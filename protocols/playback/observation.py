"""What stored brains do: many robots at once, back in their bodies, watched and measured.

The random streams of their lives are not stored, so that these are robots with the same brains, not
the same minutes over again.
"""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Callable

import numpy as np

from ...controller import PROPOSERS
from ...tasks import CONTROL_TIMESTEP, Robots
from ..agents.base import Agent
from ..experiment.experiment import Experiment
from ..experiment.schedules import control_steps
from ..results.results import Results
from ..simulation.cohort import place
from .stored_brains import stored_brains

SAMPLE = 60  # robots of a condition that are watched
SPIN_MINUTES = 2.0  # of the test, for the spinning statistic
STAY_MINUTES = 20.0  # of learning, from the rim of the spot on
SEED = 0

_SECOND = round(1 / CONTROL_TIMESTEP)  # control steps
_STILL = 0.02  # metres: who ends a second nearer to where it began did not go anywhere
_TURNED = 1.0  # radians: who turned more in a second was turning
_RIM = 0.02  # metres: who is nearer to the spot's rim is at it

Tick = Callable[[], None]


@dataclasses.dataclass(frozen=True)
class Track:
    """What B robots did in T control steps.

    Attributes:
      poses: x, y in metres and heading in radians, at the start and after every step, shape
        (T + 1, B, 3).
      events: whether they were in contact, or in the spot, after every step, shape (T, B).
      spot: x, y of the spot's centre in metres, shape (2,).
      nose: the spot's centre ahead and to the left of the nose, in metres, after every step, shape
        (T, B, 2).
    """

    poses: np.ndarray
    events: np.ndarray
    spot: np.ndarray
    nose: np.ndarray


@dataclasses.dataclass(frozen=True)
class Stay:
    """How robots behave that learn from the moment they found the spot.

    Attributes:
      staying: whether a robot spent at least a tenth of the time at the spot, shape (n,).
      following: of the first and of the last third of the time that a robot spent at the spot, the
        share that it went along the contour, shape (n, 2); NaN for a robot that left at once.
      spinning: likewise, that it spun inside.
      minutes: over those that are staying, the same two shares in every minute: minute's number,
        following, spinning; NaN where nobody was there, shape (M, 3).
    """

    staying: np.ndarray
    following: np.ndarray
    spinning: np.ndarray
    minutes: np.ndarray


@dataclasses.dataclass(frozen=True)
class Behaviour:
    """What the brains of a run do.

    Attributes:
      spinning: by task and proposer, each robot's share of the time that it spins in the test
        before and after training, shape (n, 2).
      stays: by proposer, newborn robots set at the rim of the spot, learning.
    """

    spinning: dict[tuple[str, str], np.ndarray]
    stays: dict[str, Stay]


def observe(experiment: Experiment, results: Results, tick: Tick = lambda: None) -> Behaviour:
    """Puts a sample of a run's brains back into robots and measures what they do.

    Args:
      experiment: of the run; its time scale shortens the watching too.
      results: of the run.
      tick: called every simulated minute of a group of robots; `ticks` says how often.
    """
    spinning = {}
    for task, proposer in lived(results):
        rows = sample(results, task, proposer, SAMPLE)
        if rows:
            which = [(row, when) for when in ("before", "after") for row in rows]
            minutes = SPIN_MINUTES * experiment.time_scale
            track = sit(experiment, results, task, proposer, which, minutes, tick)
            shares = spins(track.poses).mean(axis=0)
            spinning[task, proposer] = shares.reshape(2, -1).T
    stays = {}
    for proposer in (p for task, p in lived(results) if task == "spot_finding"):
        if rows := _finders(experiment, results, proposer):
            stays[proposer] = _stay(experiment, results, proposer, rows, tick)
    return Behaviour(spinning, stays)


def lived(results: Results) -> list[tuple[str, str]]:
    """The conditions whose brains are the paper's, and can be put back into robots."""
    return [condition for condition in results.conditions() if condition[1] in PROPOSERS]


def ticks(experiment: Experiment, results: Results) -> int:
    """How often `observe` ticks."""
    minutes = [
        (SPIN_MINUTES, sample(results, task, proposer, SAMPLE)) for task, proposer in lived(results)
    ] + [
        (STAY_MINUTES, _finders(experiment, results, proposer))
        for task, proposer in lived(results)
        if task == "spot_finding"
    ]
    return sum(minutes_of(m * experiment.time_scale) for m, rows in minutes if rows)


def minutes_of(minutes: float) -> int:
    """How often watching so many simulated minutes ticks."""
    return -(-control_steps(minutes) // control_steps(1))


def sample(results: Results, task: str, proposer: str, most: int) -> list[int]:
    """Rows of a condition's first valid robots; they were born in no particular order."""
    rows = enumerate(results.of(task, proposer))
    return list(itertools.islice((i for i, row in rows if row.valid), most))


def _finders(experiment: Experiment, results: Results, proposer: str) -> list[int]:
    """Rows of robots that found the spot in training: there for a tenth of it or more."""
    minutes = experiment.schedule("spot_finding").minutes_of("training")
    training = results.curves[f"spot_finding/{proposer}"][:, minutes].mean(axis=1)
    rows = sample(results, "spot_finding", proposer, len(training))
    return [row for row in rows if training[row] >= 0.1][:SAMPLE]


def sit(
    experiment: Experiment,
    results: Results,
    task: str,
    proposer: str,
    which: list[tuple[int, str]],
    minutes: float,
    tick: Tick = lambda: None,
) -> Track:
    """Lets brains sit the first minutes of their test: no learning, no exploration.

    Args:
      experiment: of the run.
      results: of the run.
      task: what the robots had to learn.
      proposer: how their actions were proposed.
      which: each brain's row within the condition, and "before" or "after" training.
      minutes: how long, simulated.
      tick: called every simulated minute.
    """
    brains = stored_brains(experiment, results, task, proposer, which, SEED)
    batch = experiment.batch(task, len(which))
    start = next(p for p in experiment.schedule(task).phases if p.part == "post")
    place(batch, start, np.random.default_rng(SEED))
    return watch(batch, brains, control_steps(minutes), learning=False, tick=tick)


def watch(batch: Robots, brains: Agent, steps: int, *, learning: bool, tick: Tick) -> Track:
    """Lets robots live from where they are, and notes where they go."""
    poses = np.empty((steps + 1, batch.robots, 3), dtype=np.float32)
    events = np.empty((steps, batch.robots), dtype=bool)
    nose = np.empty((steps, batch.robots, 2), dtype=np.float32)
    poses[0] = batch.pose
    smell = batch.rules.layout.smell
    for step in range(steps):
        motors = brains.act(batch.rules.state(batch.sensordata).astype(np.float32), learning)
        if learning:
            brains.learn(batch.rules.reward(batch.sensordata).astype(np.float32))
        batch.step(motors)
        poses[step + 1] = batch.pose
        events[step] = batch.rules.event(batch.sensordata)
        nose[step] = batch.sensordata[:, smell][:, :2]
        if (step + 1) % control_steps(1) == 0 or step + 1 == steps:
            tick()
    return Track(poses, events, batch.spot[0], nose)


def spins(poses: np.ndarray) -> np.ndarray:
    """Whether robots spin: in a second they turn by more than 1 rad and go less than 2 cm.

    Args:
      poses: x, y in metres and heading in radians, at every control step, shape (T + 1, B, 3).

    Returns:
      For every whole second, shape (T // 10, B); for less than a second, of what there is.
    """
    way, turn = _seconds(poses)
    return (way < _STILL) & (turn > _TURNED)


def _seconds(poses: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """How far robots are from where they were a second ago, and how much they turned since."""
    stride = min(_SECOND, len(poses) - 1)
    marks = np.arange(0, len(poses), stride)
    heading = np.unwrap(poses[..., 2], axis=0)[marks]
    way = np.linalg.norm(np.diff(poses[marks, :, :2], axis=0), axis=-1)
    return way, np.abs(np.diff(heading, axis=0))


def _stay(
    experiment: Experiment, results: Results, proposer: str, rows: list[int], tick: Tick
) -> Stay:
    """Sets newborn robots before the spot, their nose at its rim, and lets them learn."""
    task = "spot_finding"
    which = [(row, "before") for row in rows]
    brains = stored_brains(experiment, results, task, proposer, which, SEED)
    batch = experiment.batch(task, len(rows))
    size = batch.dimensions
    # Ahead of each robot, whose nose is at the front of its rim, lies the spot, in the middle.
    away = size.radius + size.spot_radius
    angles = np.random.default_rng(SEED).uniform(-np.pi, np.pi, len(rows))
    poses = np.stack([-away * np.cos(angles), -away * np.sin(angles), angles], axis=1)
    everyone = np.arange(batch.robots)
    batch.place_spot(everyone, np.zeros((batch.robots, 2)))
    batch.place(everyone, poses)
    steps = control_steps(STAY_MINUTES * experiment.time_scale)
    track = watch(batch, brains, steps, learning=True, tick=tick)
    return stay_of(track, size.spot_radius)


def stay_of(track: Track, spot_radius: float) -> Stay:
    """Reads from tracks who follows the contour and who spins inside.

    In a second a robot follows the contour if its nose keeps within 2 cm of the spot's rim and it
    goes more than 2 cm; it spins inside if it spins and its nose keeps inside.

    Args:
      track: of the robots.
      spot_radius: in metres.
    """
    way, turn = _seconds(track.poses)
    seconds = len(way)
    stride = (len(track.poses) - 1) // seconds
    distance = np.linalg.norm(track.nose, axis=-1)[: seconds * stride]
    distance = distance.reshape(seconds, stride, -1)
    near = (distance < spot_radius + _RIM).all(axis=1)
    follows = near & (distance > spot_radius - _RIM).all(axis=1) & (way > _STILL)
    inside = (distance < spot_radius).all(axis=1) & (way < _STILL) & (turn > _TURNED)
    staying = near.mean(axis=0) >= 0.1
    minutes = [slice(60 * minute, 60 * minute + 60) for minute in range(-(-seconds // 60))]
    there, kinds = near[:, staying], (follows[:, staying], inside[:, staying])
    return Stay(
        staying,
        np.array([_ends(*pair) for pair in zip(follows.T, near.T, strict=True)]),
        np.array([_ends(*pair) for pair in zip(inside.T, near.T, strict=True)]),
        np.array(
            [
                (number, *(_share(kind[part], there[part]) for kind in kinds))
                for number, part in enumerate(minutes)
            ]
        ),
    )


def _ends(what: np.ndarray, near: np.ndarray) -> tuple[float, float]:
    """Shares of the first and of the last third of a robot's time at the spot, shapes (T,)."""
    there = np.flatnonzero(near)
    third = -(-len(there) // 3)
    first, last = there[:third], there[len(there) - third :]
    return _share(what[first], near[first]), _share(what[last], near[last])


def _share(what: np.ndarray, near: np.ndarray) -> float:
    return float((what & near).sum() / near.sum()) if near.any() else float("nan")
