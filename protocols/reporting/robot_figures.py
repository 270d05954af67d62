"""Single robots before and after training: where they go, what they value, what occurs to them."""

from __future__ import annotations

import dataclasses

import numpy as np
import torch
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Circle, Rectangle

from ...controller import Neurocontroller
from ...models import Dimensions
from ...tasks import Robots
from ..experiment.experiment import Experiment
from ..experiment.schedules import NAMES, SCHEDULES, UPPER_LEFT, UPPER_RIGHT
from ..playback.observation import SEED, Tick, Track, lived, minutes_of, sit
from ..playback.stored_brains import stored_brains
from ..results.results import Results
from .figures import INK, canvas, colour

MINUTES = {"wall_avoidance": 4.0, "spot_finding": 15.0}  # of the test that a portrait shows
_WHEN = ("before", "after")
_EVENT = "#d0462f"
_GRID = 41


@dataclasses.dataclass(frozen=True)
class Sitter:
    """A robot chosen for its portrait.

    Attributes:
      kind: what it is an example of.
      row: within its condition.
      robot: its number there.
    """

    kind: str
    row: int
    robot: int


def proposer_of(results: Results, task: str) -> str:
    """Whose robots are portrayed: the creative ones, or else those that there are, or nobody's."""
    names = [proposer for t, proposer in lived(results) if t == task]
    return "creative" if "creative" in names else next(iter(names), "")


def sitters(results: Results, task: str) -> list[Sitter]:
    """The unmeasured, the learner that gained most and the robot that training spoiled most.

    By the time in contact, or in the spot, between the two tests; a kind that nobody is of is
    left out.
    """
    schedule, rows = SCHEDULES[task], results.of(task, proposer_of(results, task))
    sign = 1 if schedule.wanted else -1
    gains = {
        index: sign * (row.t_post_s - row.t_pre_s)
        for index, row in enumerate(rows)
        if row.valid and row.category != schedule.unmeasured
    }
    unmeasured = [i for i, row in enumerate(rows) if row.category == schedule.unmeasured]
    best, worst = (pick(gains, key=gains.__getitem__, default=None) for pick in (max, min))
    found = [(schedule.unmeasured, unmeasured[0] if unmeasured else None)]
    found.append(("learner", best if best is not None and gains[best] > 0 else None))
    found.append(("spoiled", worst if worst is not None and gains[worst] < 0 else None))
    return [Sitter(kind, i, rows[i].robot) for kind, i in found if i is not None]


def favourite(results: Results, task: str) -> Sitter | None:
    """The learner, or else whoever there is."""
    chosen = sitters(results, task)
    return next((s for s in chosen if s.kind == "learner"), chosen[0] if chosen else None)


def ticks(experiment: Experiment, results: Results) -> int:
    """How often drawing all trajectories ticks."""
    tasks = [task for task in MINUTES if any(t == task for t, _ in lived(results))]
    minutes = [MINUTES[task] * experiment.time_scale for task in tasks if sitters(results, task)]
    return sum(map(minutes_of, minutes))


# ---- Trajectories ----


def trajectories(
    experiment: Experiment, results: Results, task: str, tick: Tick = lambda: None
) -> Figure | None:
    """Where a genius or an ignorant, a learner and a spoiled robot go, before and after training.

    Returns:
      The figure; None where there is no such robot.
    """
    chosen = sitters(results, task)
    if not chosen:
        return None
    proposer, minutes = proposer_of(results, task), MINUTES[task] * experiment.time_scale
    which = [(sitter.row, when) for sitter in chosen for when in _WHEN]
    track = sit(experiment, results, task, proposer, which, minutes, tick)
    size = experiment.batch(task, 1).dimensions
    figure, axes = canvas(2.9, 2, len(chosen))
    for column, sitter in enumerate(chosen):
        for row, when in enumerate(_WHEN):
            axis = axes[row, column]
            _path(axis, track, 2 * column + row, task, size, colour(proposer))
            if row == 0:
                axis.set_title(f"{sitter.kind}, {proposer} {sitter.robot}")
            share = track.events[:, 2 * column + row].mean()
            axis.set_xlabel(f"{when}: {share:.0%} {SCHEDULES[task].event}", labelpad=2)
    return figure


def _path(axis: Axes, track: Track, index: int, task: str, size: Dimensions, shade: str) -> None:
    length, width = size.half_length, size.half_width
    axis.add_patch(Rectangle((-length, -width), 2 * length, 2 * width, fill=False, ec=INK, lw=1.0))
    if SCHEDULES[task].wanted:
        axis.add_patch(Circle(tuple(track.spot), size.spot_radius, fc=INK, alpha=0.3, lw=0))
    points = track.poses[:, index, :2]
    events = track.events[:, index]
    for drawn, paint, thick in ((~events, shade, 0.9), (events, _EVENT, 1.6)):
        # A step is drawn if either of its ends is: NaN lifts the pen.
        ends = np.concatenate([drawn[:1], drawn]) | np.concatenate([drawn, drawn[-1:]])
        axis.plot(*np.where(ends[:, None], points, np.nan).T, color=paint, lw=thick, alpha=0.8)
    axis.plot(*points[0], "o", ms=5, mfc="none", mec=INK, mew=1.0)
    axis.plot(*points[-1], "o", ms=5, color=INK)
    axis.set_xlim(-1.03 * length, 1.03 * length)
    axis.set_ylim(-1.04 * width, 1.04 * width)
    axis.set_aspect("equal")
    axis.set_xticks([])
    axis.set_yticks([])
    axis.spines[:].set_visible(False)


# ---- Values and ideas ----


def situations(batch: Robots, task: str) -> dict[str, np.ndarray]:
    """Three situations of a robot's life, as its sensors show them, each of shape (S,).

    Args:
      batch: a robot to put into them.
      task: of the batch.
    """
    size, one = batch.dimensions, np.array([0])
    reach = size.half_length - size.radius
    places: dict[str, tuple[tuple[float, float, float], bool]]
    if task == "wall_avoidance":
        places = {
            "in the open": ((0.0, 0.0, 0.0), False),
            "a wall 3 cm ahead": ((reach - 0.03, 0.0, 0.0), False),
            "pressed against it": ((reach - 0.002, 0.0, 0.0), True),
        }
    else:
        x, y, _ = UPPER_RIGHT
        places = {
            "no smell": (UPPER_LEFT, False),
            "spot 20 cm ahead": ((x - size.radius - 0.2, y, 0.0), False),
            "inside the spot": ((x - size.radius, y, 0.0), False),
        }
    states = {}
    for name, (pose, pressed) in places.items():
        batch.place_spot(one, np.array([UPPER_RIGHT[:2]]))
        batch.place(one, np.array([pose]))
        for _ in range(3 if pressed else 0):
            batch.step(np.array([[0.5, 0.5]]))
        states[name] = batch.rules.state(batch.sensordata)[0]
    return states


@torch.inference_mode()
def values(experiment: Experiment, results: Results, task: str) -> Figure | None:
    """The value of every action in three situations, and the actions proposed, before and after.

    Of the learner if there is one. Colours span the values of one panel; dots are the 25 actions
    proposed in one step, the ring is the chosen one.

    Returns:
      The figure; None where there is no robot to show.
    """
    sitter = favourite(results, task)
    if sitter is None:
        return None
    proposer = proposer_of(results, task)
    states = situations(experiment.batch(task, 1), task)
    figure, axes = canvas(4.1, 2, 3, sharex=True, sharey=True)
    for row, when in enumerate(_WHEN):
        stored = stored_brains(experiment, results, task, proposer, [(sitter.row, when)], SEED)
        brain = stored.controller
        for column, (name, state) in enumerate(states.items()):
            draw_values(axes[row, column], brain, state)
            if row == 0:
                axes[row, column].set_title(name)
        axes[row, 0].set_ylabel(f"{when} training\nright motor")
    axes[1, 1].set_xlabel("left motor")
    figure.suptitle(
        f"{NAMES[task]}, {sitter.kind}: {proposer} {sitter.robot}", x=0.01, ha="left", fontsize=9.5,
        weight="bold", color=colour(proposer),
    )  # fmt: skip
    return figure


def grid() -> torch.Tensor:
    """Actions all over the square of motors, the left motor's first, shape (1, 41 x 41, 2)."""
    line = torch.linspace(-0.5, 0.5, _GRID)
    return torch.cartesian_prod(line, line)[None]


@torch.inference_mode()
def lacking(brain: Neurocontroller, sensed: torch.Tensor, ideas: torch.Tensor) -> torch.Tensor:
    """How far ideas fall short by the brain's own judgement.

    Args:
      brain: of B robots.
      sensed: what they sense, shape (B, S).
      ideas: D draws of A ideas, shape (B, D, A, 2).

    Returns:
      What the best idea of a draw lacks to the best of all actions, as a share of the range of all
      actions' values, shape (B, D).
    """
    values = brain.values(sensed, grid().expand(len(sensed), -1, -1))
    best = brain.values(sensed, ideas.flatten(1, 2)).unflatten(1, ideas.shape[1:3]).amax(dim=2)
    most, least = values.amax(dim=1, keepdim=True), values.amin(dim=1, keepdim=True)
    return (most - best).clamp(min=0) / (most - least).clamp(min=1e-12)  # 0: all alike


def draw_values(axis: Axes, brain: Neurocontroller, state: np.ndarray) -> None:
    """Draws the value of every action, the actions proposed, and the chosen one.

    Args:
      axis: to draw on.
      brain: a single robot's.
      state: that it senses, shape (S,).
    """
    sensed = torch.from_numpy(state.astype(np.float32))[None]
    value = brain.values(sensed, grid())[0].reshape(_GRID, _GRID).numpy()
    ideas = brain.propose(sensed)
    best = ideas[0, int(brain.values(sensed, ideas)[0].argmax())]
    # left along x: rows of the picture are the right motor's
    axis.imshow(
        value.T, origin="lower", extent=(-0.5, 0.5, -0.5, 0.5), cmap="cividis",
        interpolation="bilinear", rasterized=True,
    )  # fmt: skip
    axis.plot(*ideas[0].numpy().T, "o", ms=2.6, color="white", mec="#1b222b", mew=0.4)
    axis.plot(*best.numpy(), "o", ms=8, mfc="none", mec="white", mew=1.5)
    axis.set_xticks([-0.5, 0, 0.5])
    axis.set_yticks([-0.5, 0, 0.5])
    axis.spines[:].set_visible(False)
    axis.annotate(
        f"{value.min():.2f} to {value.max():.2f}", (1, 0), xycoords="axes fraction",
        xytext=(-3, 3), textcoords="offset points", ha="right", fontsize=7,
        color="white", bbox={"fc": "#1b222b99", "ec": "none", "pad": 1.2},
    )  # fmt: skip
