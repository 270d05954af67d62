"""Figures of single robots: examples before and after training.

The robots are chosen by their measurements, and simulated with their stored brains.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import torch
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Circle, Rectangle

from ...controller import Neurocontroller
from ...tasks import Robots
from ...tasks.lives import UPPER_LEFT, UPPER_RIGHT
from ..agents.neurocontroller import NeurocontrollerAgent
from ..analysis.behaviour import Track
from ..runs.conditions import Condition
from ..runs.run import WHEN, Run, When
from .replay import evaluate, stored_brains
from .style import DARK, EVENT, INK, canvas, colour

MINUTES = {True: 15.0, False: 4.0}  # minutes of the test that trajectories show, by `Life.wanted`
_GRID = 41  # motor values along each side of the grid of all actions
_LIMITS = (-0.56, 0.56)  # of the axes: marks at the edge of the image stay whole


# ---- Examples ----


class Example(NamedTuple):
    """A robot that is an example of a kind: "genius" or "ignorant", "learner", or "spoiled"."""

    kind: str
    condition: Condition
    robot: int  # number within the condition


def examples(run: Run, task: str) -> list[Example]:
    """Returns a genius (or ignorant), and those that gained ("learner") or lost ("spoiled") most.

    They are creative if the run has creative robots. The gain is the change of the time in contact
    (or in the spot) from the test before training to the test after it, positive for an
    improvement. A kind without a robot is left out; a life without tests has no examples.
    """
    life = run.experiment.life_of(task)
    conditions = [c for c in run.conditions() if c.life == task and c.has_brain]
    if not life.tested or not conditions:
        return []
    creative = Condition(task, "creative")
    condition = creative if creative in conditions else conditions[0]
    robots = run.robots(condition)
    sign = 1 if life.wanted else -1
    unmeasured = [i for i, one in enumerate(robots) if one.category == life.unmeasured]
    measured = [i for i in run.valid_rows(condition) if i not in unmeasured]
    gains = {i: sign * (robots[i].t_post_s - robots[i].t_pre_s) for i in measured}
    found = [(life.unmeasured, i) for i in unmeasured[:1]]
    if gains:
        best, worst = max(gains, key=gains.__getitem__), min(gains, key=gains.__getitem__)
        found += [("learner", best)] * (gains[best] > 0) + [("spoiled", worst)] * (gains[worst] < 0)
    return [Example(kind, condition, i) for kind, i in found]


def favourite(run: Run, task: str) -> Example | None:
    """Returns the example "learner", or else the first example; None if there are none."""
    found = examples(run, task)
    return next((one for one in found if one.kind == "learner"), found[0] if found else None)


# ---- Trajectories ----


def trajectories(run: Run, task: str) -> Figure | None:
    """Draws example robots' paths at the beginning of the test after training, by both brains.

    Returns None without examples.
    """
    found = examples(run, task)
    if not found:
        return None
    condition = found[0].condition
    which: list[tuple[int, When]] = [(one.robot, when) for one in found for when in WHEN]
    life = run.experiment.life_of(task)
    track = evaluate(run, condition, which, MINUTES[life.wanted])
    batch = run.experiment.batch(task, 1)
    figure, axes = canvas(2.9, 2, len(found))
    for index, axis in enumerate(axes.T.flat):
        example, when = found[index // 2], WHEN[index % 2]
        _draw_arena(axis, batch, track.spots[index])
        draw_path(axis, track, index, colour(condition.proposer))
        if when == WHEN[0]:
            axis.set_title(f"{example.kind}, {condition.proposer} {example.robot}")
        share = track.events[:, index].mean()
        axis.set_xlabel(f"{when}: {share:.0%} {life.event}", labelpad=2)
    return figure


def _draw_arena(axis: Axes, batch: Robots, spot: np.ndarray) -> None:
    """Draws the walls from above, and in a task with a spot the spot; its centre is x, y in [m]."""
    size = batch.dimensions
    length, width = size.half_length, size.half_width
    axis.add_patch(Rectangle((-length, -width), 2 * length, 2 * width, fill=False, ec=INK, lw=1.0))
    if batch.rules.has_nose:
        axis.add_patch(Circle(tuple(spot), size.spot_radius, fc=INK, alpha=0.3, lw=0))
    axis.set(xlim=(-1.03 * length, 1.03 * length), ylim=(-1.04 * width, 1.04 * width))
    axis.set(aspect="equal", xticks=[], yticks=[])
    axis.spines[:].set_visible(False)


def draw_path(axis: Axes, track: Track, index: int, shade: str) -> None:
    """Draws a robot's path from a ring to a dot; violet in contact (or in the spot)."""
    points, events = track.poses[:, index, :2], track.events[:, index]
    steps = np.stack([points[:-1], points[1:], np.full_like(points[1:], np.nan)], axis=1)
    for drawn, paint, thick in ((~events, shade, 0.9), (events, EVENT, 1.2)):
        axis.plot(*steps[drawn].reshape(-1, 2).T, color=paint, lw=thick)  # NaN ends each step
    axis.plot(*points[0], "o", ms=5, mfc="none", mec=INK, mew=1.0)
    axis.plot(*points[-1], "o", ms=5, color=INK)


# ---- Values and ideas ----


def situations(batch: Robots) -> dict[str, np.ndarray]:
    """Returns the sensor signals, shape (S,), of a robot in three situations of its task, by name.

    The only robot of the batch is placed in each of them.
    """
    size, one, (x, y, _) = batch.dimensions, np.array([0]), UPPER_RIGHT
    wall = size.half_length - size.radius
    walls = {
        "in the open": (0.0, 0.0, 0.0),
        "a wall 3 cm ahead": (wall - 0.03, 0.0, 0.0),
        "pressed against it": (wall - 0.002, 0.0, 0.0),
    }
    spot = {
        "no smell": UPPER_LEFT,
        "spot 20 cm ahead": (x - size.nose - 0.2, y, 0.0),
        "inside the spot": (x - size.nose, y, 0.0),
    }
    states = {}
    for name, pose in (spot if batch.rules.has_nose else walls).items():
        batch.place_spot(one, np.array([[x, y]]))
        batch.place(one, np.array([pose]))
        for _ in range(3 if name == "pressed against it" else 0):
            batch.step(np.array([[0.5, 0.5]]))
        states[name] = batch.rules.state(batch.sensordata)[0]
    return states


@torch.inference_mode()
def values(run: Run, task: str) -> Figure | None:
    """Draws all actions' values and the ideas in three situations, before and after training.

    The robot is the `favourite`; without one, None is returned. In each panel, the colours span the
    range of its values, dots are the ideas of one step, and a ring marks the chosen idea.
    """
    example = favourite(run, task)
    if example is None:
        return None
    condition = example.condition
    states = situations(run.experiment.batch(task, 1))
    figure, axes = canvas(4.1, 2, 3, sharex=True, sharey=True)
    for axes_of_test, when in zip(axes, WHEN, strict=True):
        agent = stored_brains(run, condition, [(example.robot, when)])
        assert isinstance(agent, NeurocontrollerAgent)  # examples have brains
        for axis, state in zip(axes_of_test, states.values(), strict=True):
            draw_values(axis, agent.controller, state)
        axes_of_test[0].set_ylabel(f"{when} training\nright motor")
    for axis, name in zip(axes[0], states, strict=True):
        axis.set_title(name)
    axes[1, 1].set_xlabel("left motor")
    title = run.experiment.life_of(task).title
    figure.suptitle(
        f"{title}, {example.kind}: {condition.proposer} {example.robot}", x=0.01,
        ha="left", fontsize=9.5, weight="bold",
    )  # fmt: skip
    return figure


def draw_values(axis: Axes, brain: Neurocontroller, state: np.ndarray) -> None:
    """Draws the value of every action, the ideas of one step, and the chosen idea.

    The brain is that of a single robot, `state` its sensor signals, shape (S,).
    """
    sensed = torch.from_numpy(state.astype(np.float32))[None]
    line = torch.linspace(-0.5, 0.5, _GRID)
    actions = torch.cartesian_prod(line, line)[None]  # left motor first, shape (1, 41 x 41, 2)
    value = brain.values(sensed, actions)[0].reshape(_GRID, _GRID).numpy()
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
    above = axis.secondary_xaxis("top")  # the panel's title moves above it
    above.set_xticks([])
    above.spines[:].set_visible(False)
    above.set_xlabel(f"{value.min():z.2f} to {value.max():z.2f}", fontsize=7, labelpad=1)
