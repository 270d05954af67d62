"""Measures the behaviour of a run's robots: simulates many robots with stored brains in lockstep.

A run does not store the random streams of its robots. Robots therefore have the same brains as in
the run, but their motion differs from that in the run.
"""

from __future__ import annotations

import numpy as np

from ..analysis.behaviour import Behaviour, Track, spins, stay_of
from ..lives.conditions import Condition
from ..lives.run import WHEN, Run, When
from ..lives.schedules import control_steps
from .rollout import SEED, Tick, evaluate, ticks_of, watch
from .stored_brains import stored_brains

SAMPLE = 60  # robots observed in each condition
SPIN_MINUTES = 2.0  # of the test, in which spinning is measured
STAY_MINUTES = 20.0  # of learning, from the rim of the spot on


def observe(run: Run, tick: Tick = lambda: None) -> Behaviour:
    """Measures the behaviour of a sample of a run's robots.

    Args:
      run: Run of the robots; its time scale also scales the duration of the observation.
      tick: Function called after every simulated minute of a batch, `ticks(run)` times in all.
    """
    spinning, nearer = {}, {}
    for condition in with_brains(run):
        if rows := sample(run, condition, SAMPLE):
            which: list[tuple[int, When]] = [(row, when) for when in WHEN for row in rows]
            minutes = SPIN_MINUTES * run.experiment.time_scale
            track = evaluate(run, condition, which, minutes, tick)
            shares = spins(track.poses).mean(axis=0)
            spinning[condition] = shares.reshape(2, -1).T
            away = np.linalg.norm(track.poses[[0, -1], :, :2], axis=-1)  # the centre is the origin
            nearer[condition] = (away[0] - away[1]).reshape(2, -1).T
    stays = {}
    for condition in _searching(run):
        if rows := finders(run, condition):
            track, radius = from_the_rim(run, condition, rows, tick)
            stays[condition.proposer] = stay_of(track, radius)
    return Behaviour(spinning, stays, nearer)


def ticks(run: Run) -> int:
    """Returns the number of times that `observe` calls `tick`."""
    batches = [(SPIN_MINUTES, sample(run, condition, SAMPLE)) for condition in with_brains(run)]
    batches += [(STAY_MINUTES, finders(run, condition)) for condition in _searching(run)]
    scale = run.experiment.time_scale
    return sum(ticks_of(minutes * scale) for minutes, rows in batches if rows)


def with_brains(run: Run) -> list[Condition]:
    """Returns the conditions whose robots have a stored neurocontroller."""
    return [condition for condition in run.conditions() if condition.has_brain]


def sample(run: Run, condition: Condition, most: int) -> list[int]:
    """Returns the rows of a condition's first valid robots; their order is arbitrary.

    Args:
      run: Run of the robots.
      condition: Condition of the robots.
      most: Largest number of rows to return.
    """
    return run.valid_rows(condition)[:most]


def _searching(run: Run) -> list[Condition]:
    return [condition for condition in with_brains(run) if condition.task == "spot_finding"]


def finders(run: Run, condition: Condition) -> list[int]:
    """Returns the first rows of robots that spent at least a tenth of training in the spot."""
    minutes = run.experiment.schedule(condition.task).minutes_of("training")
    training = run.results[condition].curves[:, minutes].mean(axis=1)
    return [row for row in run.valid_rows(condition) if training[row] >= 0.1][:SAMPLE]


def from_the_rim(
    run: Run, condition: Condition, rows: list[int], tick: Tick
) -> tuple[Track, float]:
    """Places untrained robots with their nose at the rim of the spot and lets them learn.

    Args:
      run: Run of the robots.
      condition: Condition of the robots, in spot finding.
      rows: Rows of the robots within the condition.
      tick: Function called after every simulated minute.

    Returns:
      The robots' track over `STAY_MINUTES`, and the radius of the spot in [m].
    """
    agent = stored_brains(run, condition, [(row, "before") for row in rows], SEED)
    batch = run.experiment.batch(condition.task, len(rows))
    size = batch.dimensions
    # The spot is in the middle, ahead of each robot.
    away = size.nose + size.spot_radius
    angles = np.random.default_rng(SEED).uniform(-np.pi, np.pi, len(rows))
    poses = np.stack([-away * np.cos(angles), -away * np.sin(angles), angles], axis=1)
    everyone = np.arange(batch.robots)
    batch.place_spot(everyone, np.zeros((batch.robots, 2)))
    batch.place(everyone, poses)
    steps = control_steps(STAY_MINUTES * run.experiment.time_scale)
    track = watch(batch, agent, steps, learning=True, tick=tick)
    return track, size.spot_radius
