"""Measures the behaviour of a run's robots: simulates many robots with stored brains in lockstep.

Robots have the same brains as in the run, but their motion differs (see `replay`).
"""

from __future__ import annotations

import numpy as np

from ...tasks.lives import control_steps
from ..analysis.behaviour import Behaviour, Track, spins, stay_of
from ..runs.conditions import Condition
from ..runs.run import WHEN, Run, When
from .replay import SEED, evaluate, stored_brains, watch

SAMPLE = 60  # robots observed in each condition, the first valid ones
SPIN_MINUTES = 2.0  # minutes of the test in which spinning is measured
STAY_MINUTES = 20.0  # minutes of learning that begins at the spot's rim


def observe(run: Run) -> Behaviour:
    """Measures the behaviour of a sample of a run's robots that have a stored neurocontroller.

    The run's time scale also scales the duration of the observation.
    """
    spinning, nearer, stays = {}, {}, {}
    for condition in run.conditions():
        rows = run.valid_rows(condition)[:SAMPLE]
        tested = run.experiment.life_of(condition.life).tested
        if not rows or not condition.has_brain or not tested:
            continue
        which: list[tuple[int, When]] = [(row, when) for when in WHEN for row in rows]
        track = evaluate(run, condition, which, SPIN_MINUTES)
        spinning[condition] = spins(track.poses).mean(axis=0).reshape(2, -1).T
        away = np.linalg.norm(track.poses[[0, -1], :, :2], axis=-1)  # the centre is the origin
        nearer[condition] = (away[0] - away[1]).reshape(2, -1).T
        if condition.life == "spot_finding" and (rows := finders(run, condition)):
            stays[condition.proposer] = stay_of(*from_the_rim(run, condition, rows))
    return Behaviour(spinning, stays, nearer)


def finders(run: Run, condition: Condition) -> list[int]:
    """Returns up to `SAMPLE` rows of robots that spent at least a tenth of training in the spot."""
    minutes = run.experiment.life_of(condition.life).minutes_of("training")
    training = run.results[condition].curves[:, minutes].mean(axis=1)
    return [row for row in run.valid_rows(condition) if training[row] >= 0.1][:SAMPLE]


def from_the_rim(run: Run, condition: Condition, rows: list[int]) -> tuple[Track, float]:
    """Places untrained robots with their nose at the rim of the spot and lets them learn.

    `rows` are the robots' rows in the condition. Returns their track, `STAY_MINUTES` long (times
    the time scale), and the radius of the spot in [m].
    """
    agent = stored_brains(run, condition, [(row, "before") for row in rows])
    batch = run.experiment.batch(condition.life, len(rows))
    size = batch.dimensions
    # The spot is in the arena's centre, ahead of each robot.
    away = size.nose + size.spot_radius
    angles = np.random.default_rng(SEED).uniform(-np.pi, np.pi, len(rows))
    poses = np.stack([-away * np.cos(angles), -away * np.sin(angles), angles], axis=1)
    everyone = np.arange(batch.robots)
    batch.place_spot(everyone, np.zeros((batch.robots, 2)))
    batch.place(everyone, poses)
    steps = control_steps(STAY_MINUTES * run.experiment.time_scale)
    what = f"{condition} at the rim"
    return watch(batch, agent, steps, learning=True, what=what), size.spot_radius
