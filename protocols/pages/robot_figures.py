"""Figures of single robots before and after training: their paths, and the values of actions."""

from __future__ import annotations

import numpy as np
import torch
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Circle, Rectangle

from ...controller import Neurocontroller
from ...models import Dimensions
from ..analysis.behaviour import Track
from ..analysis.regret import GRID, grid, situations
from ..lives.conditions import Condition
from ..lives.run import WHEN, Run, When
from ..lives.schedules import SCHEDULES, TASK_NAMES
from .example_robots import examples, favourite, proposer_of
from .rollout import SEED, Tick, evaluate, ticks_of
from .stored_brains import stored_brains
from .style import DARK, EVENT, INK, canvas, colour

MINUTES = {"wall_avoidance": 4.0, "spot_finding": 15.0}  # of the test that trajectories show
_LIMITS = (-0.56, 0.56)  # of motor values: marks at the edge of the image stay whole


def ticks(run: Run) -> int:
    """Returns how often `trajectories` calls `tick`, over all tasks of a run."""
    scale = run.experiment.time_scale
    return sum(ticks_of(MINUTES[task] * scale) for task in run.tasks() if examples(run, task))


# ---- Trajectories ----


def trajectories(run: Run, task: str, tick: Tick = lambda: None) -> Figure | None:
    """Draws the example robots' paths in the first minutes of both tests.

    Args:
      run: The run.
      task: Task of the robots.
      tick: Function called after every simulated minute.

    Returns:
      The figure; None if the task has no example robots.
    """
    found = examples(run, task)
    if not found:
        return None
    condition = Condition(task, proposer_of(run, task))
    minutes = MINUTES[task] * run.experiment.time_scale
    which: list[tuple[int, When]] = [(one.row, when) for one in found for when in WHEN]
    track = evaluate(run, condition, which, minutes, tick)
    size = run.experiment.batch(task, 1).dimensions
    figure, axes = canvas(2.9, 2, len(found))
    for column, example in enumerate(found):
        for row, when in enumerate(WHEN):
            axis, index = axes[row, column], 2 * column + row
            draw_arena(axis, track, task, size)
            draw_path(axis, track, index, colour(condition.proposer))
            if row == 0:
                axis.set_title(f"{example.kind}, {condition.proposer} {example.robot}")
            share = track.events[:, index].mean()
            axis.set_xlabel(f"{when}: {share:.0%} {SCHEDULES[task].event}", labelpad=2)
    return figure


def draw_arena(axis: Axes, track: Track, task: str, size: Dimensions) -> None:
    """Draws the walls from above, and the spot in a task with a spot."""
    length, width = size.half_length, size.half_width
    axis.add_patch(Rectangle((-length, -width), 2 * length, 2 * width, fill=False, ec=INK, lw=1.0))
    if SCHEDULES[task].wanted:
        axis.add_patch(Circle(tuple(track.spot), size.spot_radius, fc=INK, alpha=0.3, lw=0))
    axis.set(xlim=(-1.03 * length, 1.03 * length), ylim=(-1.04 * width, 1.04 * width))
    axis.set(aspect="equal", xticks=[], yticks=[])
    axis.spines[:].set_visible(False)


def draw_path(axis: Axes, track: Track, index: int, shade: str) -> None:
    """Draws a robot's path from a ring to a dot; violet where the event happens."""
    points, events = track.poses[:, index, :2], track.events[:, index]
    for drawn, paint, thick in ((~events, shade, 0.9), (events, EVENT, 1.2)):
        # A step is drawn if either of its ends is; NaN interrupts the line.
        ends = np.concatenate([drawn[:1], drawn]) | np.concatenate([drawn, drawn[-1:]])
        axis.plot(*np.where(ends[:, None], points, np.nan).T, color=paint, lw=thick)
    axis.plot(*points[0], "o", ms=5, mfc="none", mec=INK, mew=1.0)
    axis.plot(*points[-1], "o", ms=5, color=INK)


# ---- Values and ideas ----


@torch.inference_mode()
def values(run: Run, task: str) -> Figure | None:
    """Draws all actions' values and the ideas in three situations, before and after training.

    The robot is the `favourite`. In each panel, the colours span the range of its values, dots are
    the ideas of one step, and a ring marks the chosen idea.

    Args:
      run: The run.
      task: Task of the robot.

    Returns:
      The figure; None if the task has no example robot.
    """
    example = favourite(run, task)
    if example is None:
        return None
    condition = Condition(task, proposer_of(run, task))
    states = situations(run.experiment.batch(task, 1), task)
    figure, axes = canvas(4.1, 2, 3, sharex=True, sharey=True)
    for row, when in enumerate(WHEN):
        brain = stored_brains(run, condition, [(example.row, when)], SEED).controller
        for column, (name, state) in enumerate(states.items()):
            draw_values(axes[row, column], brain, state)
            if row == 0:
                axes[row, column].set_title(name)
        axes[row, 0].set_ylabel(f"{when} training\nright motor")
    axes[1, 1].set_xlabel("left motor")
    figure.suptitle(
        f"{TASK_NAMES[task]}, {example.kind}: {condition.proposer} {example.robot}", x=0.01,
        ha="left", fontsize=9.5, weight="bold",
    )  # fmt: skip
    return figure


def draw_values(axis: Axes, brain: Neurocontroller, state: np.ndarray) -> None:
    """Draws the value of every action, the ideas of one step, and the chosen idea.

    Args:
      axis: Axes to draw on.
      brain: Brain of a single robot.
      state: Sensor signals, shape (S,).
    """
    sensed = torch.from_numpy(state.astype(np.float32))[None]
    value = brain.values(sensed, grid())[0].reshape(GRID, GRID).numpy()
    ideas = brain.propose(sensed)
    best = ideas[0, int(brain.values(sensed, ideas)[0].argmax())]
    # The left motor along x: rows of the image are values of the right motor.
    axis.imshow(
        value.T, origin="lower", extent=(-0.5, 0.5, -0.5, 0.5), cmap="cividis",
        interpolation="bilinear", rasterized=True,
    )  # fmt: skip
    axis.plot(*ideas[0].numpy().T, "o", ms=2.6, color="white", mec=DARK, mew=0.4, clip_on=False)
    for edge, thick in ((DARK, 2.6), ("white", 1.3)):  # visible on light and on dark values
        axis.plot(*best.numpy(), "o", ms=8, mfc="none", mec=edge, mew=thick, clip_on=False)
    axis.set(xticks=[-0.5, 0, 0.5], yticks=[-0.5, 0, 0.5], xlim=_LIMITS, ylim=_LIMITS)
    axis.spines[:].set_visible(False)
    above = axis.secondary_xaxis("top")  # a title of the panel moves above it
    above.set_xticks([])
    above.spines[:].set_visible(False)
    above.set_xlabel(f"{value.min():z.2f} to {value.max():z.2f}", fontsize=7, labelpad=1)
