"""Typical robots of a run (section 4): a spinner, one that follows the contour, a slow approacher.

Measured numbers choose the robots; stored brains are put back into their robots.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from ...tasks import CONTROL_TIMESTEP
from ..analysis.behaviour import RIM, Track, spins, stay_of
from ..lives.conditions import Condition
from ..lives.run import Run
from ..lives.schedules import control_steps
from . import measured_behaviour
from .measured_behaviour import SPIN_MINUTES, STAY_MINUTES, from_the_rim, sample
from .robot_figures import draw_arena, draw_path
from .rollout import Tick, evaluate, ticks_of
from .style import canvas, colour

APPROACH_MINUTES = 40.0  # of the test after training in which approachers are looked for
SPINS = 0.1  # least share of time: a robot that spins less only turns away from walls
SLOW = 25.0  # [min]: the paper's slow robots arrive after 20 to 30 minutes
DRAWN_MINUTES = 3.0  # of the follower's path, where it follows most; more would fill the spot
_APPROACHERS = 30  # robots among which the slow one is looked for
_ORDER = {"wall_avoidance": ("fixed", "creative", "random"), "spot_finding": ("creative",)}


@dataclasses.dataclass(frozen=True)
class Typical:
    """A robot that is typical of a behaviour.

    Attributes:
      kind: Name of the behaviour.
      condition: Condition of the robot.
      row: Row of the robot within its condition.
      track: Track of a batch with the robot.
      index: Index of the robot in the track.
      words: What was measured.
      reach: Half of the width, along y, of the part of the arena that is drawn, in [m]; None for
        all of it. A part is drawn around the middle of the robot's path.
      drawn: First and last control step of the path that is drawn; None for all of it.
    """

    kind: str
    condition: Condition
    row: int
    track: Track
    index: int
    words: str
    reach: float | None = None
    drawn: tuple[int, int] | None = None


def ticks(run: Run) -> int:
    """Returns how often `typical_robots` calls `tick`."""
    scale, count = run.experiment.time_scale, 0
    if (condition := _condition(run, "wall_avoidance")) and sample(run, condition, 1):
        count += ticks_of(SPIN_MINUTES * scale)
    if condition := _condition(run, "spot_finding"):
        if measured_behaviour.finders(run, condition):
            count += ticks_of(STAY_MINUTES * scale)
        if _arriving(run, condition):
            count += ticks_of(APPROACH_MINUTES * scale)
    return count


def typical_robots(run: Run, tick: Tick = lambda: None) -> Iterator[Typical]:
    """Yields the typical robots of a run; a kind without a robot is left out.

    The spinner spins most in the first minutes of the test after training, and for at least
    `SPINS` of the time. The follower's share of following the spot's contour in the first third of
    its time there, plus its share of spinning inside in the last third, is the largest among
    newborns that start at the rim and learn. The slow approacher arrives at the spot nearest to
    `SLOW` minutes after the start of the test.

    Args:
      run: The run.
      tick: Function called after every simulated minute, `ticks(run)` times.
    """
    scale = run.experiment.time_scale
    condition = _condition(run, "wall_avoidance")
    if condition and (rows := sample(run, condition, measured_behaviour.SAMPLE)):
        minutes = SPIN_MINUTES * scale
        track = evaluate(run, condition, [(row, "after") for row in rows], minutes, tick)
        shares = spins(track.poses).mean(axis=0)
        best = int(shares.argmax())
        words = f"spins in {shares[best]:.0%} of\nthe first {minutes:g} minutes"
        if shares[best] >= SPINS:
            yield Typical("spinner", condition, rows[best], _front(run, track), best, words, 0.06)
    condition = _condition(run, "spot_finding")
    if condition is None:
        return
    if rows := measured_behaviour.finders(run, condition):
        track, radius = from_the_rim(run, condition, rows, tick)
        stay = stay_of(track, radius)
        change = np.where(stay.staying, stay.following[:, 0] + stay.spinning[:, 1], np.nan)
        if not np.isnan(change).all():
            index = int(np.nanargmax(change))
            words = (
                f"follows the rim {stay.following[index, 0]:.0%},\n"
                f"at last spins {stay.spinning[index, 1]:.0%}"
            )
            drawn = _at_the_rim(track.nose[:, index], radius, control_steps(DRAWN_MINUTES * scale))
            yield Typical(
                "contour follower", condition, rows[index], track, index, words, 2 * radius, drawn
            )
    if rows := _arriving(run, condition):
        minutes = APPROACH_MINUTES * scale
        track = evaluate(run, condition, [(row, "after") for row in rows], minutes, tick)
        arrived = np.flatnonzero(track.events.any(axis=0) & ~track.events[0])
        if len(arrived):
            times = track.events.argmax(axis=0) * CONTROL_TIMESTEP / 60
            index = int(arrived[np.abs(times[arrived] - SLOW * scale).argmin()])
            words = f"reaches the spot after\n{times[index]:.3g} minutes"
            yield Typical("slow approacher", condition, rows[index], track, index, words)


def draw(run: Run, tick: Tick = lambda: None) -> Figure | None:
    """Draws the typical robots' paths side by side; None if the run has none."""
    found = [*typical_robots(run, tick)]
    if not found:
        return None
    figure, axes = canvas(2.1, 1, len(found))
    for axis, one in zip(axes[0], found, strict=True):
        task = one.condition.task
        first, last = one.drawn or (0, len(one.track.events))
        draw_arena(axis, one.track, task, run.experiment.batch(task, 1).dimensions)
        path = dataclasses.replace(
            one.track, poses=one.track.poses[first : last + 1], events=one.track.events[first:last]
        )
        draw_path(axis, path, one.index, colour(one.condition.proposer))
        if one.reach:
            x, y = (
                one.track.poses[:, one.index, :2].mean(axis=0)
                if one.kind == "spinner"
                else one.track.spot
            )
            wide = 1.5 * one.reach
            axis.set(xlim=(x - wide, x + wide), ylim=(y - one.reach, y + one.reach))
        number = run.robots(one.condition)[one.row].robot
        axis.set_title(f"{one.kind}\n{one.condition.proposer} {number}")
        axis.set_xlabel(one.words, fontsize=8)
    return figure


def _condition(run: Run, task: str) -> Condition | None:
    """Returns the condition whose robots are looked at; None if the run has none with brains."""
    wanted = [Condition(task, proposer) for proposer in _ORDER[task]]
    return next((c for c in wanted if c in run.results and c.has_brain), None)


def _front(run: Run, track: Track) -> Track:
    """Returns a track with the places of the robots' fronts, which move while a robot spins."""
    radius = run.experiment.batch("wall_avoidance", 1).dimensions.radius
    poses, heading = track.poses.copy(), track.poses[..., 2]
    poses[..., :2] += radius * np.stack([np.cos(heading), np.sin(heading)], axis=-1)
    return dataclasses.replace(track, poses=poses)


def _at_the_rim(nose: np.ndarray, radius: float, steps: int) -> tuple[int, int]:
    """Returns the stretch of so many steps in which a robot's nose is at the rim for longest."""
    near = np.abs(np.linalg.norm(nose, axis=-1) - radius) < RIM
    first = int(np.convolve(near, np.ones(steps), "valid").argmax())
    return first, first + steps


def _arriving(run: Run, condition: Condition) -> list[int]:
    """Returns the rows of the first robots that were in the spot in the test after training."""
    rows: list[Any] = run.robots(condition)
    return [row for row in run.valid_rows(condition) if rows[row].t_post_s > 0][:_APPROACHERS]
