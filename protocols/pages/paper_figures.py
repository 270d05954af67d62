"""The paper's two figures, made from our own objects: the architecture, and the robot."""

from __future__ import annotations

import contextlib
from collections.abc import Sequence
from typing import Any, NamedTuple

import mujoco
import numpy as np
import torch
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle
from matplotlib.patheffects import withStroke

from ...controller import CreativeMemory, Neurocontroller, Parameters
from ...controller.networks import Networks
from ...models import robot_qpos
from ...tasks.rules import RANGEFINDERS
from ...tasks.suite import task_definition
from ..agents.senses import senses_of
from .offscreen import Canvas
from .style import CATEGORY_COLOURS, DARK, INK, WIDTH, colour

_NOISE, _BLUE, _RED = "#cf7423", CATEGORY_COLOURS[0], "#c2565b"
_LAYERS = (1.55, 3.0, 4.15)  # x of the inputs, hidden neurons and outputs of a network
_PALE = "#8f98a3"  # of hidden neurons
_SEED = 1  # of the newborn brain that is drawn


# ---- Figure 1: the architecture ----


def architecture(task: str) -> Figure:
    """Draws the two networks of a newborn creative robot of the paper, and what passes between.

    Neurons, connections, the connections with noise of one idea, and the ideas of one step are
    those of a `Neurocontroller`.
    """
    senses, sensors = senses_of(task), list[str]()
    for name, (length, _, _) in task_definition(task).rules.shapes.items():
        sensors += RANGEFINDERS if name == "distances" else [name] * length
    parameters = Parameters()
    controller = Neurocontroller(parameters, "creative", 1, len(sensors), _SEED, senses)
    memory, evaluation = controller.memory, controller.evaluation.networks
    assert isinstance(memory, CreativeMemory)
    memory.patterns.renew()
    pattern = memory.patterns.draw(1)[0].numpy()
    state = torch.tensor([[signal.low / 2 + signal.high / 2 for signal in senses.state]])
    ideas = controller.propose(state)[0].numpy()
    values = controller.values(state, torch.from_numpy(ideas)[None])[0].numpy()

    figure = Figure(figsize=(WIDTH, 4.5))
    axis = _bare_axes(figure)
    axis.set(xlim=(0, 10), ylim=(0, 8))

    _box(axis, (0.1, 4.35, 4.9, 3.5), f"creative memory: {_sizes(memory.networks)}")
    motors = ("left", "right")
    _network(axis, memory.networks, (4.75, 7.3), sensors, motors, pattern)
    noise = f"noise of {parameters.noise:g} in {memory.patterns.noisy} of {len(pattern)} weights"
    _write(axis, 0.25, 4.45, f"an idea: {noise}", _NOISE, fontsize=7.5)
    _draw_ideas(figure.add_axes((0.63, 0.63, 0.2, 0.25)), ideas, int(values.argmax()))
    _box(axis, (0.1, 0.15, 4.9, 3.95), f"evaluation network: {_sizes(evaluation)}")
    names = (*sensors, "left motor", "right motor")
    silent = np.zeros(evaluation.hidden_weights[0].numel() + evaluation.output_weights[0].numel())
    _network(axis, evaluation, (0.45, 3.55), names, ("value",), silent)

    _arrow(axis, (5.0, 6.3), (5.5, 6.3))
    _arrow(axis, (6.6, 4.25), (5.05, 3.3))
    _write(axis, 6.1, 3.55, "each idea is evaluated")
    _box(axis, (6.3, 1.5, 1.85, 1.25), "")
    choice = f"highest value,\nor with \u03b5 = {parameters.epsilon:g}\nany idea"
    _write(axis, 7.22, 2.12, choice, ha="center", va="center")
    _arrow(axis, (5.05, 2.12), (6.25, 2.12))
    _write(axis, 5.62, 2.27, "values", ha="center", fontsize=7.5)
    _arrow(axis, (8.2, 2.12), (8.75, 2.12))
    _write(axis, 8.85, 2.12, "motors", va="center", fontsize=8.5)
    _write(axis, 8.85, 0.75, "reward r", _RED, va="center", fontsize=8.5)
    _arrow(axis, (8.75, 0.75), (5.05, 0.75), _RED)
    error = "TD error \u03b4 = r + \u03b3V(t+1) \u2212 V(t)"
    _write(axis, 6.9, 0.87, error, _RED, ha="center")
    rates = f"\u03b3 = {parameters.discount:g}, learn rate {parameters.learn_rate:g}"
    _write(axis, 6.9, 0.42, rates, _RED, ha="center", fontsize=7.5)
    axis.plot([8.6, 8.6, 9.85, 9.85, 8.25], [0.75, 0.2, 0.2, 7.75, 7.75], color=_RED, lw=1.1)
    _arrow(axis, (8.3, 7.75), (5.05, 7.75), _RED)
    lesson = "\u03b4 is the memory's learn rate"
    _write(axis, 9.75, 4.9, lesson, _RED, rotation=90, ha="right", va="center")
    return figure


def _sizes(networks: Networks) -> str:
    """Returns the numbers of inputs, hidden neurons and outputs as text."""
    _, hidden, inputs = networks.hidden_weights.shape
    return f"{inputs}-{hidden}-{networks.output_weights.shape[1]}"


def _draw_ideas(axis: Axes, ideas: np.ndarray, best: int) -> None:
    ticks, limits = [-0.5, 0, 0.5], (-0.55, 0.55)
    axis.plot(*ideas.T, "o", ms=3, color=colour("creative"), mew=0)
    axis.plot(*ideas[best], "o", ms=8, mfc="none", mec=INK, mew=1.3)
    axis.set(xlim=limits, ylim=limits, xticks=ticks, yticks=ticks)
    axis.set_title(f"{len(ideas)} ideas of one step", fontsize=8, loc="center")
    axis.set_xlabel("left motor", fontsize=7.5, labelpad=1)
    axis.set_ylabel("right motor", fontsize=7.5, labelpad=-3)
    axis.tick_params(labelsize=7)


def _network(
    axis: Axes,
    networks: Networks,
    rows: tuple[float, float],
    inputs: Sequence[str],
    outputs: Sequence[str],
    pattern: np.ndarray,
) -> None:
    """Draws the first robot's network: width is the size of a weight, colour its sign or noise."""
    low, high = rows
    layers = networks.hidden_weights[0].numpy(), networks.output_weights[0].numpy()
    sizes = len(inputs), len(layers[0]), len(outputs)
    places = [
        [(x, high - (high - low) * (k + 0.5) / n) for k in range(n)]
        for x, n in zip(_LAYERS, sizes, strict=True)
    ]
    noises = iter(pattern)
    for weights, sources, targets in zip(layers, places[:-1], places[1:], strict=True):
        for (to, source), weight in np.ndenumerate(weights):
            own = bool(next(noises))
            axis.plot(
                *zip(sources[source], targets[to], strict=True),
                lw=1.8 if own else 0.2 + 1.0 * abs(weight),
                color=_NOISE if own else _BLUE if weight > 0 else INK,
                alpha=0.95 if own else 0.55, zorder=2 if own else 1,
            )  # fmt: skip
    for column, paint in zip(places, (INK, _PALE, INK), strict=True):
        axis.plot(*zip(*column, strict=True), "o", ms=8.5, mfc=paint, mec="none", zorder=3)
    for names, column, side, place in (
        (inputs, places[0], -0.2, "right"),
        (outputs, places[-1], 0.2, "left"),
    ):
        for name, (x, y) in zip(names, column, strict=True):
            _write(axis, x + side, y, name, ha=place, va="center", fontsize=7.5)


def _box(axis: Axes, place: tuple[float, float, float, float], title: str) -> None:
    x, y, width, height = place
    axis.add_patch(Rectangle((x, y), width, height, fill=False, ec=INK, lw=0.8))
    _write(axis, x + 0.12, y + height - 0.12, title, va="top", fontsize=9, weight="bold")


def _write(axis: Axes, x: float, y: float, words: str, paint: str = INK, **options: Any) -> None:
    axis.text(x, y, words, **{"color": paint, "fontsize": 8, **options})


def _arrow(
    axis: Axes, start: tuple[float, float], end: tuple[float, float], paint: str = INK
) -> None:
    style = {"arrowstyle": "-|>", "color": paint, "lw": 1.1, "shrinkA": 0, "shrinkB": 0}
    axis.annotate("", end, start, arrowprops=style | {"mutation_scale": 9})


# ---- Figure 2: the robot ----


class Part(NamedTuple):
    """A part of the robot that the figure names."""

    words: str
    at: tuple[float, float]  # the label's outer end, in pixels from the upper left
    kind: str  # of MuJoCo's objects that are the part; the label points at the nearest one
    names: tuple[str, ...]  # of these objects
    offset: tuple[float, float, float] = (0.0, 0.0, 0.0)  # of the point from the object, in [m]


PARTS = (
    Part("points ahead", (34, 209), "site", ("heading",)),
    Part("nose", (34, 310), "site", ("nose",)),
    Part(f"{len(RANGEFINDERS)} distance sensors", (34, 410), "site", RANGEFINDERS[:1]),
    Part("2 castors", (34, 511), "geom", ("front_castor", "back_castor")),
    Part("2 wheels\nwith motors", (1086, 259), "geom", ("left_wheel", "right_wheel")),
    Part("bumper,\nsenses contact", (1086, 461), "geom", ("bumper",), (0.0015, 0.0268, 0.0)),
)
_WIDTH, _HEIGHT, _FOVY = 1120, 720, 20.0  # [pixels], [deg]
_EYE, _TARGET = np.array([0.17, 0.13, 0.085]), np.array([0.0, 0.0, 0.014])  # [m]
_HALO = withStroke(linewidth=2.2, foreground="white")
_LINE = {"arrowstyle": "-", "color": DARK, "lw": 0.9, "shrinkB": 0, "path_effects": [_HALO]}


def robot() -> Figure:
    """Draws the robot with its sensors; every label points at a place that the model gives.

    Raises:
      InputError: there is no EGL.
    """
    spec = task_definition("spot_finding").spec()
    ahead = (_TARGET - _EYE) / np.linalg.norm(_TARGET - _EYE)
    right = np.cross(ahead, [0, 0, 1])
    right /= np.linalg.norm(right)
    frame = np.stack([right, np.cross(right, ahead), ahead])
    turn = np.empty(4)
    mujoco.mju_mat2Quat(turn, (frame * [[1], [1], [-1]]).T.ravel())
    spec.worldbody.add_camera(name="portrait", pos=_EYE, quat=turn, fovy=_FOVY)
    spec.material("musebot_shell").rgba[3] = 0.35  # so that wheels and castors are seen
    spec.geom("bumper").rgba = [0.6, 0.62, 0.65, 0.55]
    spec.visual.quality.shadowsize = 8192
    model = spec.compile()
    data = mujoco.MjData(model)
    data.qpos[:] = robot_qpos(np.zeros(3))
    data.mocap_pos[0, :2] = 10, 10  # out of the picture
    mujoco.mj_forward(model, data)
    with contextlib.closing(Canvas(model, "portrait", _WIDTH, _HEIGHT)) as drawn:
        drawn.look(data)
        picture = drawn.pixels().copy()

    figure = Figure(figsize=(WIDTH, WIDTH * _HEIGHT / _WIDTH))
    axis = _bare_axes(figure)
    axis.imshow(picture, interpolation="lanczos")
    scale = 0.5 * _HEIGHT / np.tan(np.radians(_FOVY) / 2)
    for part in PARTS:
        places = [getattr(data, part.kind)(name).xpos + part.offset for name in part.names]
        x, y, depth = min((frame @ (place - _EYE) for place in places), key=np.linalg.norm)
        anchor = _WIDTH / 2 + scale * x / depth, _HEIGHT / 2 - scale * y / depth
        axis.annotate(
            part.words, anchor, part.at, ha="left" if part.at[0] < _WIDTH / 2 else "right",
            va="center", fontsize=9, color=DARK, arrowprops=_LINE,
        )  # fmt: skip
        axis.plot(*anchor, "o", ms=3.6, color=DARK, mec="white", mew=0.6)
    return figure


def _bare_axes(figure: Figure) -> Axes:
    """Returns axes that fill the figure, without ticks and frame."""
    axis = figure.add_axes((0, 0, 1, 1))
    axis.set(xticks=[], yticks=[])
    axis.spines[:].set_visible(False)
    return axis
