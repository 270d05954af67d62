"""What a moment of a film looks like: the arena from above, and a panel of instruments."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Protocol

import matplotlib
import mujoco
import numpy as np
from PIL import Image, ImageDraw, ImageFont

from ...models import robot_qpos
from ...tasks import CONTROL_TIMESTEP
from ...tasks.rules import RANGEFINDERS
from ...tasks.spot_finding import SpotFindingRules
from ...tasks.suite import TASKS
from .offscreen import Canvas

WIDTH, HEIGHT = 960, 540  # pixels; H.264 wants even numbers
_HEADER, _PANEL = 44, 240
_STAGE = (WIDTH - _PANEL, HEIGHT - _HEADER)

# Of each signal that is shown by gauges: what it is called, and the gauges' names.
_GAUGES = {
    "nose": ("nose", ("odour",)),
    "noses": ("nose", ("left", "right")),
    "distances": ("distance", RANGEFINDERS),
    "speed": ("speed", ("ahead",)),
}
_NOSES = {"nose": ("nose",), "noses": ("left_nose", "right_nose")}  # the sites that smell

Colour = tuple[float, float, float]
_BLUE, _GREY, _AMBER = (0.13, 0.42, 0.66), (0.46, 0.53, 0.62), (0.98, 0.65, 0.15)
_RED, _GREEN, _MOSS = (0.89, 0.20, 0.16), (0.16, 0.66, 0.27), (0.04, 0.34, 0.12)
_INK, _DIM, _GROOVE, _BACK, _HEAD = "#f2f4f7", "#98a2b1", "#39414f", "#1f252f", "#161b23"


@dataclasses.dataclass(frozen=True)
class Shot:
    """What a picture shows.

    Attributes:
      time: simulated seconds since the episode began.
      pose: x, y in metres and heading in radians, shape (3,).
      spot: x, y of its centre, in metres, shape (2,).
      signals: the robot's sensor signals by name, each of shape (n,).
      motors: left and right, in [-0.5, 0.5], shape (2,).
      contact: whether the robot is in contact.
      event: whether it is in contact, or in the spot: what the task measures the time of.
      event_seconds: how long it has been so, since the episode began.
      trail: where it was, the latest last: x, y in metres, shape (n, 2).
      trail_events: whether it was in contact, or in the spot, there, shape (n,).
      trail_ages: 0 for now, 1 for where the trail ends, shape (n,).
    """

    time: float
    pose: np.ndarray
    spot: np.ndarray
    signals: dict[str, np.ndarray]
    motors: np.ndarray
    contact: bool
    event: bool
    event_seconds: float
    trail: np.ndarray
    trail_events: np.ndarray
    trail_ages: np.ndarray


class Stage:
    """The arena from above, with the robot's trail and what it senses.

    Attributes:
      renderer: the name of what draws.
    """

    def __init__(self, task: str) -> None:
        """Sets the stage of a task of the table.

        Raises:
          InputError: there is no EGL.
        """
        self._model = TASKS[task].spec().compile()
        self._data = mujoco.MjData(self._model)
        self._rules = TASKS[task].rules.of(self._model)
        self._canvas = Canvas(self._model, "overhead", *_STAGE)
        self.renderer = self._canvas.renderer

    def draw(self, shot: Shot) -> np.ndarray:
        """Returns the picture, shape (height, width, 3)."""
        self._data.qpos[:] = robot_qpos(shot.pose)
        self._data.mocap_pos[0, :2] = shot.spot
        mujoco.mj_forward(self._model, self._data)
        self._canvas.look(self._data)
        self._trail(shot)
        if isinstance(self._rules, SpotFindingRules):
            self._odours(shot, self._rules.nose.frustum)
        if "distances" in shot.signals:
            self._distances(shot)
        return self._canvas.pixels()

    def close(self) -> None:
        """Frees what OpenGL holds."""
        self._canvas.close()

    def _trail(self, shot: Shot) -> None:
        event = _MOSS if isinstance(self._rules, SpotFindingRules) else _RED
        points = np.column_stack([shot.trail, np.full(len(shot.trail), 0.0015)])
        for k in range(len(points) - 1):
            colour = event if shot.trail_events[k + 1] else _BLUE
            self._line(points[k], points[k + 1], 4, colour, 0.85 * (1 - shot.trail_ages[k]))

    def _distances(self, shot: Shot) -> None:
        if shot.contact:
            self._ring(shot.pose, 0.034, 0.031, 5, _RED)
        # Measured in the pose that is drawn, between two control steps perhaps.
        distances = self._data.sensordata[self._rules.layout.distances]
        for name, distance, signal in zip(
            RANGEFINDERS, distances, shot.signals["distances"], strict=True
        ):
            if distance < 0:
                continue
            site = self._data.site(name)
            end = site.xpos + distance * site.xmat.reshape(3, 3)[:, 2]
            colour = heat(signal, _RED)
            self._line(site.xpos, end, 3, colour, 0.55 + 0.45 * signal)
            self._add(mujoco.mjtGeom.mjGEOM_SPHERE, [0.004] * 3, end, np.eye(3), colour, 1)

    def _odours(self, shot: Shot, frustum: float) -> None:
        if shot.event:
            self._ring(shot.spot, 0.062, 0.002, 5, _GREEN)
        for name in _NOSES.keys() & shot.signals.keys():
            for side, signal in enumerate(shot.signals[name]):
                height = 0.002 + 0.0001 * side  # so that two of them do not share a plane
                self._odour(_NOSES[name][side], float(signal), frustum, height)

    def _odour(
        self,
        site: str,
        signal: float,
        frustum: float,
        height: float,
        reach: float = 0.24,
        slices: int = 12,
    ) -> None:
        nose = self._data.site(site)
        ahead = np.arctan2(nose.xmat[3], nose.xmat[0])
        angles = ahead + np.linspace(-frustum / 2, frustum / 2, slices + 1)
        rays = np.column_stack([np.cos(angles), np.sin(angles)])
        clear = np.minimum(reach, _to_wall(nose.xpos[:2], rays, self._model))
        # Sectors on top of one another: denser towards the nose.
        for layer, share in enumerate((1.0, 0.75, 0.5, 0.25)):
            corners = np.minimum(clear, share * reach)[:, None] * rays
            base = np.array([*nose.xpos[:2], height + 0.0002 * layer])
            for first, second in zip(corners[:-1], corners[1:], strict=True):
                # The triangle (0, 0), (1, 0), (0, 1), in a frame of the sector's two edges.
                frame = np.eye(3)
                frame[:2, 0], frame[:2, 1] = first, second
                triangle = mujoco.mjtGeom.mjGEOM_TRIANGLE
                alpha = 0.14 + 0.16 * signal
                self._add(triangle, [1, 1, 0], base, frame, heat(signal, _GREEN), alpha)

    def _ring(
        self, centre: np.ndarray, radius: float, height: float, pixels: float, colour: Colour
    ) -> None:
        angles = np.linspace(0, 2 * np.pi, 41)
        x, y = centre[0] + radius * np.cos(angles), centre[1] + radius * np.sin(angles)
        points = np.column_stack([x, y, np.full(len(angles), height)])
        for first, second in zip(points[:-1], points[1:], strict=True):
            self._line(first, second, pixels, colour, 1)

    def _line(
        self, start: np.ndarray, end: np.ndarray, pixels: float, colour: Colour, alpha: float
    ) -> None:
        kind = mujoco.mjtGeom.mjGEOM_LINE
        geom = self._add(kind, [0, 0, 0], start, np.eye(3), colour, alpha)
        if geom is not None:
            mujoco.mjv_connector(geom, kind.value, pixels, start, end)

    def _add(
        self,
        kind: mujoco.mjtGeom,
        size: list[float],
        position: np.ndarray,
        frame: np.ndarray,
        colour: Colour,
        alpha: float,
    ) -> mujoco.MjvGeom | None:
        scene = self._canvas.scene
        if scene.ngeom >= scene.maxgeom:
            return None
        geom = scene.geoms[scene.ngeom]
        scene.ngeom += 1
        rgba = np.array([*colour, alpha], dtype=np.float32)
        mujoco.mjv_initGeom(geom, kind.value, np.array(size, float), position, frame.ravel(), rgba)
        geom.category = mujoco.mjtCatBit.mjCAT_DECOR.value  # casts no shadow
        geom.emission, geom.specular = 0.15, 0.0
        return geom


def heat(signal: float, hot: Colour) -> Colour:
    """The colour of a signal: grey at 0, amber half way, `hot` at 1."""
    stops = np.array([_GREY, _AMBER, hot])
    red, green, blue = (np.interp(signal, [0, 0.5, 1], stops[:, k]) for k in range(3))
    return float(red), float(green), float(blue)


def _to_wall(start: np.ndarray, rays: np.ndarray, model: mujoco.MjModel) -> np.ndarray:
    """Metres from a point to the wall along unit vectors, shape (n,) for rays of (n, 2)."""
    half = np.array([model.geom("east").pos[0], model.geom("north").pos[1]])
    with np.errstate(divide="ignore"):
        distances = (np.copysign(half, rays) - start) / rays
    return np.maximum(distances, 0).min(axis=1)


class Instrument(Protocol):
    """Something that is drawn onto the panel, from a height downwards."""

    def __call__(self, draw: ImageDraw.ImageDraw, y: int, shot: Shot) -> int:
        """Draws itself and returns the height below it."""
        ...


class Panel:
    """Title, clock, signals, motors and time in contact or in the spot, around a stage."""

    def __init__(self, task: str, driver: str, trained: bool, speed: float, seconds: float) -> None:
        """Prepares what stays the same.

        Args:
          task: of the table, what is shown.
          driver: who drives, in words.
          trained: whether the driver has learnt before.
          speed: simulated seconds in a second of the film.
          seconds: simulated seconds that the film shows.
        """
        self._shapes = TASKS[task].rules.shapes
        # Whether the event is good (in the spot) or bad (in contact).
        self._wanted = issubclass(TASKS[task].rules, SpotFindingRules)
        self._seconds = seconds
        self._events: list[tuple[float, float]] = []  # from, to: shares of the film
        self._seen = 0.0
        self._hot = _GREEN if self._wanted else _RED
        self._small, self._text, self._bold = _font(11), _font(13), _font(17, "-Bold")
        self._large, self._digits = _font(22, "-Bold"), _font(30, "-Bold", "Mono")
        self._figures = _font(12, "", "Mono")
        self._blank = Image.new("RGB", (WIDTH, HEIGHT), _BACK)
        draw = ImageDraw.Draw(self._blank)
        draw.rectangle((0, 0, WIDTH, _HEADER - 1), fill=_HEAD)
        title = task.replace("_", " ").capitalize()
        draw.text((20, _HEADER / 2), title, _INK, self._bold, "lm")
        x = 20 + self._bold.getlength(title) + 14
        draw.text((x, _HEADER / 2 + 1), driver, _DIM, _font(14), "lm")
        when = "after training" if trained else "before training"
        chip = _font(13, "-Bold")
        left = WIDTH - 20 - chip.getlength(when) - 24
        fill = _hex(_GREEN if trained else _AMBER)
        pill = Image.new("L", (4 * round(WIDTH - 20 - left), 4 * 24))
        ImageDraw.Draw(pill).rounded_rectangle((0, 0, pill.width - 1, pill.height - 1), 48, 255)
        self._blank.paste(fill, (round(left), 10), pill.reduce(4))
        draw.text(((left + WIDTH - 20) / 2, 22), when, _HEAD, chip, "mm")
        self._speed = f"{speed:g} \N{MULTIPLICATION SIGN} real time"

    def frame(self, stage: np.ndarray, shot: Shot) -> np.ndarray:
        """Returns the picture, shape (HEIGHT, WIDTH, 3): a stage and its panel."""
        picture = self._blank.copy()
        picture.paste(Image.fromarray(stage), (0, _HEADER))
        draw = ImageDraw.Draw(picture)
        self._remember(shot)
        y = self._clock(draw, _HEADER + 24, shot)
        for instrument in (self._signals, self._lamps, self._motors, self._total, self._timeline):
            y = instrument(draw, y, shot)
        return np.asarray(picture)

    def _remember(self, shot: Shot) -> None:
        if shot.event:
            self._events.append((self._seen, shot.time))
        self._seen = shot.time

    def _clock(self, draw: ImageDraw.ImageDraw, y: int, shot: Shot) -> int:
        x = WIDTH - _PANEL + 20
        draw.text((x, y), "Simulated time", _DIM, self._small, "lm")
        draw.text((WIDTH - 20, y), self._speed, _DIM, self._small, "rm")
        minutes, seconds = divmod(int(10 * shot.time + 0.5), 600)
        draw.text((x - 1, y + 30), f"{minutes:02d}:{seconds / 10:04.1f}", _INK, self._digits, "lm")
        return y + 84

    def _signals(self, draw: ImageDraw.ImageDraw, y: int, shot: Shot) -> int:
        names = [name for name in self._shapes if name in _GAUGES]
        words = " and ".join(_GAUGES[name][0] for name in names)
        y = self._heading(draw, y, f"{words.capitalize()} signals")
        for name in names:
            _, low, high = self._shapes[name]
            for gauge, signal in zip(_GAUGES[name][1], shot.signals[name], strict=True):
                if low < 0:
                    y = self._balance(draw, y, gauge, float(signal), high)
                else:
                    y = self._gauge(draw, y, gauge, float(signal))
        return y

    def _lamps(self, draw: ImageDraw.ImageDraw, y: int, shot: Shot) -> int:
        x = WIDTH - _PANEL + 20
        if "contact" in self._shapes:
            text = "in contact" if shot.contact else "no contact"
            self._lamp(draw, x, y, shot.contact, _RED, text)
            x += 100
        if self._wanted:
            text = "in the spot" if shot.event else "off the spot"
            self._lamp(draw, x, y, shot.event, _GREEN, text)
        return y + 48

    def _motors(self, draw: ImageDraw.ImageDraw, y: int, shot: Shot) -> int:
        y = self._heading(draw, y, "Motors")
        for name, motor in zip(("left", "right"), shot.motors, strict=True):
            y = self._balance(draw, y, name, float(motor), 0.5)
        return y + 26

    def _total(self, draw: ImageDraw.ImageDraw, y: int, shot: Shot) -> int:
        y = self._heading(draw, y, "Time in the spot" if self._wanted else "Time in contact")
        x = WIDTH - _PANEL + 20
        draw.text((x, y + 6), f"{shot.event_seconds:.1f} s", _INK, self._large, "lm")
        share = shot.event_seconds / max(shot.time, CONTROL_TIMESTEP)
        draw.text((WIDTH - 20, y + 7), f"{min(share, 1):.1%}", _DIM, self._text, "rm")
        return y + 36

    def _timeline(self, draw: ImageDraw.ImageDraw, y: int, shot: Shot) -> int:
        left, right = WIDTH - _PANEL + 20, WIDTH - 20

        def at(time: float) -> float:
            return left + (right - left) * min(time / self._seconds, 1)

        draw.rectangle((left, y, right, y + 12), _GROOVE)
        for start, end in self._events:
            draw.rectangle((at(start), y, at(end), y + 12), _hex(self._hot))
        draw.line((at(shot.time), y - 3, at(shot.time), y + 15), _INK, 2)
        return y + 30

    def _heading(self, draw: ImageDraw.ImageDraw, y: int, text: str) -> int:
        draw.text((WIDTH - _PANEL + 20, y), text, _DIM, self._small, "lm")
        return y + 24

    def _row(
        self, draw: ImageDraw.ImageDraw, y: int, name: str, value: str
    ) -> tuple[float, float, float]:
        """Draws a gauge's name, value and groove; returns the groove's left, right, middle."""
        left, right = WIDTH - _PANEL + 62, WIDTH - 70
        draw.text((WIDTH - _PANEL + 20, y), name, _INK, self._text, "lm")
        draw.text((WIDTH - 20, y), value, _INK, self._figures, "rm")
        draw.rectangle((left, y - 4, right, y + 4), _GROOVE)
        return left, right, y

    def _gauge(self, draw: ImageDraw.ImageDraw, y: int, name: str, signal: float) -> int:
        left, right, middle = self._row(draw, y, name, f"{signal:.3f}")
        tip = left + signal * (right - left)
        draw.rectangle((left, middle - 4, tip, middle + 4), _hex(heat(signal, self._hot)))
        return y + 26

    def _balance(
        self, draw: ImageDraw.ImageDraw, y: int, name: str, value: float, limit: float
    ) -> int:
        """A gauge of a value in [-limit, limit], from its middle."""
        left, right, middle = self._row(draw, y, name, f"{value:+.2f}")
        centre = (left + right) / 2
        tip = centre + value / (2 * limit) * (right - left)
        draw.rectangle((min(centre, tip), middle - 4, max(centre, tip), middle + 4), _hex(_BLUE))
        draw.line((centre, middle - 7, centre, middle + 7), _DIM)
        return y + 26

    def _lamp(
        self, draw: ImageDraw.ImageDraw, x: int, y: int, lit: bool, colour: Colour, text: str
    ) -> None:
        fill = _hex(colour) if lit else _GROOVE
        draw.text((x, y), "\N{BLACK CIRCLE}", fill, self._bold, "lm")
        draw.text((x + 22, y), text, _INK if lit else _DIM, self._text, "lm")


def _hex(colour: Colour) -> str:
    return "#" + "".join(f"{round(255 * part):02x}" for part in colour)


def _font(size: int, style: str = "", family: str = "") -> ImageFont.FreeTypeFont:
    # Matplotlib brings its own fonts: the same letters on every machine.
    folder = Path(matplotlib.get_data_path()) / "fonts" / "ttf"
    return ImageFont.truetype(folder / f"DejaVuSans{family}{style}.ttf", size)
