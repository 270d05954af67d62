"""Simulates batches of robots with an agent, and records their tracks."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterable, Iterator, Sequence

import numpy as np

from ...tasks import Robots
from ..agents.base import Agent
from ..analysis.behaviour import Track
from ..lives.conditions import Condition
from ..lives.placement import place
from ..lives.run import Run, When
from ..lives.schedules import Phase, control_steps
from .stored_brains import stored_brains

SEED = 0  # of the random streams that a run does not store

Tick = Callable[[], None]
"""Called after every simulated minute of a batch."""


@dataclasses.dataclass(frozen=True)
class Mode:
    """What agents do besides acting.

    Attributes:
      exploring: Whether they explore.
      learning: Whether they learn.
    """

    exploring: bool = False
    learning: bool = False


FROZEN = Mode()


def evaluate(
    run: Run,
    condition: Condition,
    which: Sequence[tuple[int, When]],
    minutes: float,
    tick: Tick = lambda: None,
) -> Track:
    """Evaluates stored brains with frozen weights in the first minutes of their test.

    Args:
      run: Run of the brains.
      condition: Condition of the brains.
      which: For each brain, a pair: the robot's row within the condition, and "before" or "after"
        for the brain before or after training.
      minutes: Simulated minutes to evaluate.
      tick: Function called after every simulated minute.
    """
    agent = stored_brains(run, condition, which, SEED)
    batch = run.experiment.batch(condition.task, len(which))
    schedule = run.experiment.schedule(condition.task)
    start = next(phase for phase in schedule.phases if phase.part == "post")
    place(batch, start, np.random.default_rng(SEED))
    return watch(batch, agent, control_steps(minutes), learning=False, tick=tick)


def watch(batch: Robots, agent: Agent, steps: int, *, learning: bool, tick: Tick) -> Track:
    """Simulates robots from their current poses and records their track.

    Args:
      batch: Batch of B robots that have been placed.
      agent: Agent that drives the robots.
      steps: Number of control steps.
      learning: Whether the robots learn and explore.
      tick: Function called after every simulated minute.
    """
    mode = Mode(exploring=learning, learning=learning)
    poses = np.empty((steps + 1, batch.robots, 3), dtype=np.float32)
    events = np.empty((steps, batch.robots), dtype=bool)
    nose = np.empty((steps, batch.robots, 2), dtype=np.float32)
    poses[0] = batch.pose
    smell = batch.rules.layout.smell
    for step, event in enumerate(_events(batch, agent, steps, mode, tick)):
        poses[step + 1] = batch.pose
        events[step] = event
        nose[step] = batch.sensordata[:, smell][:, :2]
    return Track(poses, events, batch.spot[0], nose)


def count_events(
    batch: Robots,
    agent: Agent,
    steps: int,
    *,
    tick: Tick,
    mode: Mode = FROZEN,
) -> np.ndarray:
    """Simulates robots from their current poses, without a record of their track.

    Args:
      batch: Batch of B robots that have been placed.
      agent: Agent that drives the robots.
      steps: Number of control steps.
      tick: Function called after every simulated minute.
      mode: What the robots do besides acting.

    Returns:
      Number of control steps in contact, or in the spot, of each robot, int32, shape (B,).
    """
    counts = np.zeros(batch.robots, dtype=np.int32)
    for event in _events(batch, agent, steps, mode, tick):
        counts += event
    return counts


def repeat_test(
    batch: Robots,
    agent: Agent,
    phases: Iterable[Phase],
    random: np.random.Generator,
    *,
    tick: Tick,
    mode: Mode = FROZEN,
) -> np.ndarray:
    """Simulates the phases of a test, each from its own placement.

    Args:
      batch: Batch of B robots.
      agent: Agent that drives the robots; it is reset at each placement.
      phases: Phases of the test.
      random: Random stream of the placements.
      tick: Function called after every simulated minute.
      mode: What the robots do besides acting.

    Returns:
      Number of control steps in contact, or in the spot, of each robot, int32, shape (B,).
    """
    counts = np.zeros(batch.robots, dtype=np.int32)
    for phase in phases:
        place(batch, phase, random)
        agent.reset()
        steps = control_steps(phase.minutes)
        counts += count_events(batch, agent, steps, tick=tick, mode=mode)
    return counts


def _events(
    batch: Robots, agent: Agent, steps: int, mode: Mode, tick: Tick
) -> Iterator[np.ndarray]:
    """Yields after every control step which robots are in contact, or in the spot, shape (B,)."""
    rules = batch.rules
    for step in range(1, steps + 1):
        motors = agent.act(rules.state(batch.sensordata).astype(np.float32), mode.exploring)
        if mode.learning:
            agent.learn(rules.reward(batch.sensordata).astype(np.float32))
        batch.step(motors)
        yield rules.event(batch.sensordata)
        if step % control_steps(1) == 0 or step == steps:
            tick()


def ticks_of(minutes: float) -> int:
    """Returns how often a simulation of `minutes` simulated minutes calls `tick`."""
    return -(-control_steps(minutes) // control_steps(1))
