"""The paper's two figures, made from our own objects: the architecture, and the robot."""

from __future__ import annotations

from typing import Any, NamedTuple

import mujoco
import numpy as np
import torch
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import FancyArrowPatch, Rectangle
from matplotlib.patheffects import withStroke

from ...controller import CreativeMemory, Neurocontroller, Parameters
from ...controller.networks import Networks
from ...models import robot_qpos
from ...tasks.rules import RANGEFINDERS
from ...tasks.suite import task_definition
from ..agents.senses import senses_of
from .offscreen import Canvas
from .style import CATEGORY_COLOURS, INK, WIDTH, colour

_NOISE, _BLUE, _RED, _DARK = "#cf7423", CATEGORY_COLOURS[0], "#c2565b", "#1b222b"
_PALE = "#8f98a3"  # of hidden neurons
_SEED = 1  # of the newborn brain that is drawn


# ---- Figure 1: the architecture ----


def architecture(task: str) -> Figure:
    """Draws the two networks of a newborn creative robot of the paper, and what passes between.

    Neurons, connections, the connections with noise of one idea, and the ideas of one step are
    those of a `Neurocontroller`.

    Args:
      task: Task of the paper, "wall_avoidance" or "spot_finding".
    """
    senses, sensors = senses_of(task), _sensors(task)
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
    axis = figure.add_axes((0, 0, 1, 1))
    axis.set(xlim=(0, 10), ylim=(0, 8), xticks=[], yticks=[])
    axis.spines[:].set_visible(False)

    _box(axis, (0.1, 4.35, 4.9, 3.5), f"creative memory: {_sizes(memory.networks)}")
    motors = ("left", "right")
    _network(axis, memory.networks, (1.55, 3.0, 4.15), (4.75, 7.3), sensors, motors, pattern)
    noise = f"noise of {parameters.noise:g} in {memory.patterns.noisy} of {len(pattern)} weights"
    _write(axis, 0.25, 4.45, f"an idea: {noise}", _NOISE, fontsize=7.5)
    _draw_ideas(figure.add_axes((0.63, 0.63, 0.2, 0.25)), ideas, int(values.argmax()))
    _box(axis, (0.1, 0.15, 4.9, 3.95), f"evaluation network: {_sizes(evaluation)}")
    names = (*sensors, "left motor", "right motor")
    _network(axis, evaluation, (1.55, 3.0, 4.15), (0.45, 3.55), names, ("value",), None)

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


def _sensors(task: str) -> tuple[str, ...]:
    """Returns the names of the signals of a state, in their order."""
    found: list[str] = []
    for name, (length, _, _) in task_definition(task).rules.shapes.items():
        found += RANGEFINDERS if name == "distances" else [name] * length
    return tuple(found)


def _network(
    axis: Axes,
    networks: Networks,
    columns: tuple[float, float, float],
    rows: tuple[float, float],
    inputs: tuple[str, ...],
    outputs: tuple[str, ...],
    pattern: np.ndarray | None,
) -> None:
    """Draws the first robot's network: width is the size of a weight, colour its sign or noise."""
    first, second = networks.hidden_weights[0].numpy(), networks.output_weights[0].numpy()
    low, high = rows
    places = [
        [(x, high - (high - low) * (k + 0.5) / n) for k in range(n)]
        for x, n in zip(columns, (first.shape[1], *second.T.shape), strict=True)
    ]
    noisy = np.zeros(first.size + second.size) if pattern is None else pattern
    signs = noisy[: first.size].reshape(first.shape), noisy[first.size :].reshape(second.shape)
    for layer, (weights, noise) in enumerate(zip((first, second), signs, strict=True)):
        for (to, source), weight in np.ndenumerate(weights):
            (x, y), (u, v) = places[layer][source], places[layer + 1][to]
            own = bool(noise[to, source])
            axis.plot(
                [x, u], [y, v], lw=1.8 if own else 0.2 + 1.0 * abs(weight),
                color=_NOISE if own else _BLUE if weight > 0 else INK,
                alpha=0.95 if own else 0.55, zorder=2 if own else 1,
            )  # fmt: skip
    for layer, (column, paint) in enumerate(zip(places, (INK, _PALE, INK), strict=True)):
        for k, (x, y) in enumerate(column):
            axis.plot(x, y, "o", ms=8.5, mfc=paint, mec="none", zorder=3)
            if layer == 1:
                continue
            name, side = (inputs[k], -1) if layer == 0 else (outputs[k], 1)
            place = "right" if side < 0 else "left"
            axis.text(x + 0.2 * side, y, name, ha=place, va="center", fontsize=7.5, color=INK)


def _box(axis: Axes, place: tuple[float, float, float, float], title: str) -> None:
    x, y, width, height = place
    axis.add_patch(Rectangle((x, y), width, height, fill=False, ec=INK, lw=0.8))
    axis.text(x + 0.12, y + height - 0.12, title, va="top", fontsize=9, weight="bold", color=INK)


def _write(axis: Axes, x: float, y: float, words: str, paint: str = INK, **options: Any) -> None:
    axis.text(x, y, words, **{"color": paint, "fontsize": 8, **options})


def _arrow(
    axis: Axes, start: tuple[float, float], end: tuple[float, float], paint: str = INK
) -> None:
    style: dict[str, Any] = {"arrowstyle": "-|>", "mutation_scale": 9, "lw": 1.1}
    axis.add_patch(FancyArrowPatch(start, end, color=paint, shrinkA=0, shrinkB=0, **style))


# ---- Figure 2: the robot ----


class Part(NamedTuple):
    """A part of the robot that the figure names.

    Attributes:
      words: The label.
      kind: Kind of MuJoCo object that shows where the part is.
      names: Names of the objects that are the part; the label points at the nearest one.
      rim: Whether the label points at the rim of a cylinder, not at its centre.
    """

    words: str
    kind: str
    names: tuple[str, ...]
    rim: bool = False


PARTS = (
    Part(f"{len(RANGEFINDERS)} distance sensors", "site", RANGEFINDERS[:1]),
    Part("nose", "site", ("nose",)),
    Part("bumper,\nsenses contact", "geom", ("bumper",), rim=True),
    Part("2 wheels\nwith motors", "geom", ("left_wheel", "right_wheel")),
    Part("2 castors", "geom", ("front_castor", "back_castor")),
    Part("points ahead", "site", ("heading",)),
)
_WIDTH, _HEIGHT, _FOVY = 1120, 720, 20.0  # [pixels], [deg]
_EYE, _TARGET = np.array([0.17, 0.13, 0.085]), np.array([0.0, 0.0, 0.014])  # [m]


def robot() -> Figure:
    """Draws the robot with its sensors; every label points at a place that the model gives.

    Raises:
      InputError: there is no EGL.
    """
    spec = task_definition("spot_finding").spec()
    ahead = (_TARGET - _EYE) / np.linalg.norm(_TARGET - _EYE)
    right = np.cross(ahead, [0, 0, 1]) / np.linalg.norm(np.cross(ahead, [0, 0, 1]))
    up = np.cross(right, ahead)
    turn = np.empty(4)
    mujoco.mju_mat2Quat(turn, np.column_stack([right, up, -ahead]).ravel())
    spec.worldbody.add_camera(name="portrait", pos=_EYE, quat=turn, fovy=_FOVY)
    spec.material("musebot_shell").rgba[3] = 0.35  # so that wheels and castors are seen
    spec.geom("bumper").rgba = [0.6, 0.62, 0.65, 0.55]
    spec.visual.quality.shadowsize = 8192
    model = spec.compile()
    data = mujoco.MjData(model)
    data.qpos[:] = robot_qpos(np.zeros(3))
    data.mocap_pos[0, :2] = 10, 10  # out of the picture
    mujoco.mj_forward(model, data)
    drawn = Canvas(model, "portrait", _WIDTH, _HEIGHT)
    try:
        drawn.look(data)
        picture = drawn.pixels().copy()
    finally:
        drawn.close()

    def seen(place: np.ndarray) -> np.ndarray:
        """Returns the pixel at which the camera sees a point."""
        x, y, depth = (float((place - _EYE) @ axis) for axis in (right, up, ahead))
        scale = 0.5 * _HEIGHT / np.tan(np.radians(_FOVY) / 2) / depth
        return np.array([_WIDTH / 2 + x * scale, _HEIGHT / 2 - y * scale])

    figure = Figure(figsize=(WIDTH, WIDTH * _HEIGHT / _WIDTH))
    axis = figure.add_axes((0, 0, 1, 1))
    axis.imshow(picture, interpolation="lanczos")
    axis.set(xticks=[], yticks=[])
    axis.spines[:].set_visible(False)
    anchors = []
    for part in PARTS:
        places = [getattr(data, part.kind)(name).xpos for name in part.names]
        if part.rim:  # the point of the rim towards the camera, a little to its right
            aside = right + 0.9 * np.array([*-ahead[:2], 0])
            places = [places[0] + model.geom("bumper").size[0] / np.sqrt(1 + 0.9**2) * aside]
        anchors.append(seen(min(places, key=lambda place: float(np.sum((place - _EYE) ** 2)))))
    for side, (edge, align) in enumerate(((0.03, "left"), (0.97, "right"))):
        own = [k for k, anchor in enumerate(anchors) if (anchor[0] > _WIDTH / 2) == bool(side)]
        own.sort(key=lambda k: anchors[k][1])
        for place, k in enumerate(own):
            at = edge * _WIDTH, (0.22 + 0.56 * (place + 0.5) / len(own)) * _HEIGHT
            _label(axis, PARTS[k].words, anchors[k], at, align)
    return figure


def _label(axis: Axes, words: str, anchor: Any, at: tuple[float, float], align: str) -> None:
    halo = [withStroke(linewidth=2.2, foreground="white")]
    line = {"arrowstyle": "-", "color": _DARK, "lw": 0.9, "shrinkB": 0, "path_effects": halo}
    axis.annotate(
        words, anchor, at, ha=align, va="center", fontsize=9, color=_DARK, arrowprops=line
    )
    axis.plot(*anchor, "o", ms=3.6, color=_DARK, mec="white", mew=0.6)
