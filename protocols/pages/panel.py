"""The parts of a film's frame around the scene: title, clock, sensor signals and motors."""

from __future__ import annotations

from pathlib import Path

import matplotlib
import numpy as np
from PIL import Image, ImageDraw, ImageFont

from ...tasks import CONTROL_TIMESTEP
from ...tasks.rules import RANGEFINDERS
from ...tasks.spot_finding import SpotFindingRules
from ...tasks.suite import TASKS
from . import scene
from .replay import Moment
from .scene import AMBER, BLUE, GREEN, RED, Colour, heat

_HEADER, _PANEL = 44, 240
WIDTH, HEIGHT = scene.WIDTH + _PANEL, scene.HEIGHT + _HEADER  # [pixels]; H.264 needs even numbers

# Title and gauges of each sensor signal that has gauges.
_GAUGES = {
    "nose": ("nose", ("smell",)),
    "noses": ("nose", ("left", "right")),
    "distances": ("distance", RANGEFINDERS),
    "speed": ("speed", ("ahead",)),
}
_LEFT, _RIGHT = scene.WIDTH + 20, WIDTH - 20  # of what the panel shows
_INK, _DIM, _GROOVE, _BACK, _HEAD = "#f2f4f7", "#98a2b1", "#39414f", "#1f252f", "#161b23"


class Panel:
    """Draws the frame: a header above the scene and a panel of instruments to its right.

    The method of an instrument draws it from height `y` downwards, and returns the height below it.
    """

    def __init__(self, task: str, driver: str, trained: bool, speed: float, seconds: float) -> None:
        """Draws the parts that are the same in all frames.

        Args:
          task: Task of the domain "arena".
          driver: Description of the driver in a few words.
          trained: Whether the driver has been trained.
          speed: Simulated seconds per second of the film.
          seconds: Simulated duration of the film in [s].
        """
        self._shapes = TASKS[task].rules.shapes
        # Whether the event is wanted (in the spot) or not (in contact).
        self._wanted = issubclass(TASKS[task].rules, SpotFindingRules)
        self._hot = GREEN if self._wanted else RED
        self._seconds = seconds
        self._speed = f"{speed:g} \N{MULTIPLICATION SIGN} real time"
        self._events: list[tuple[float, float]] = []  # start and end in [s]
        self._seen = 0.0
        self._small, self._text, self._bold = _font(11), _font(13), _font(17, "-Bold")
        self._large, self._digits = _font(22, "-Bold"), _font(30, "-Bold", "Mono")
        self._figures = _font(12, "", "Mono")
        self._blank = Image.new("RGB", (WIDTH, HEIGHT), _BACK)
        self._header(task.replace("_", " ").capitalize(), driver, trained)

    def _header(self, title: str, driver: str, trained: bool) -> None:
        draw = ImageDraw.Draw(self._blank)
        draw.rectangle((0, 0, WIDTH, _HEADER - 1), fill=_HEAD)
        draw.text((20, _HEADER / 2), title, _INK, self._bold, "lm")
        x = 20 + self._bold.getlength(title) + 14
        draw.text((x, _HEADER / 2 + 1), driver, _DIM, _font(14), "lm")
        when = "after training" if trained else "before training"
        chip = _font(13, "-Bold")
        left = _RIGHT - chip.getlength(when) - 24
        pill = Image.new("L", (4 * round(_RIGHT - left), 4 * 24))
        ImageDraw.Draw(pill).rounded_rectangle((0, 0, pill.width - 1, pill.height - 1), 48, 255)
        self._blank.paste(_hex(GREEN if trained else AMBER), (round(left), 10), pill.reduce(4))
        draw.text(((left + _RIGHT) / 2, 22), when, _HEAD, chip, "mm")

    def frame(self, image: np.ndarray, shot: Moment) -> np.ndarray:
        """Returns a frame; its timeline also shows the events of all earlier calls.

        Args:
          image: Image of the scene, uint8, shape (scene.HEIGHT, scene.WIDTH, 3).
          shot: What the instruments show.

        Returns:
          Pixels of the frame, uint8, shape (HEIGHT, WIDTH, 3).
        """
        frame = self._blank.copy()
        frame.paste(Image.fromarray(image), (0, _HEADER))
        draw, y = ImageDraw.Draw(frame), _HEADER + 24
        self._remember(shot)
        for instrument in (
            self._clock, self._signals, self._lamps, self._motors, self._total, self._timeline
        ):  # fmt: skip
            y = instrument(draw, y, shot)
        return np.asarray(frame)

    def _remember(self, shot: Moment) -> None:
        if shot.event:
            start = self._seen
            if self._events and self._events[-1][1] == start:  # it goes on
                start, _ = self._events.pop()
            self._events.append((start, shot.time))
        self._seen = shot.time

    def _clock(self, draw: ImageDraw.ImageDraw, y: int, shot: Moment) -> int:
        draw.text((_LEFT, y), "Simulated time", _DIM, self._small, "lm")
        draw.text((_RIGHT, y), self._speed, _DIM, self._small, "rm")
        minutes, seconds = divmod(int(10 * shot.time + 0.5), 600)
        clock = f"{minutes:02d}:{seconds / 10:04.1f}"
        draw.text((_LEFT - 1, y + 30), clock, _INK, self._digits, "lm")
        return y + 84

    def _signals(self, draw: ImageDraw.ImageDraw, y: int, shot: Moment) -> int:
        names = [name for name in self._shapes if name in _GAUGES]
        words = " and ".join(_GAUGES[name][0] for name in names)
        y = self._heading(draw, y, f"{words.capitalize()} signals")
        for name in names:
            _, low, high = self._shapes[name]
            for gauge, signal in zip(_GAUGES[name][1], shot.signals[name], strict=True):
                y = self._gauge(draw, y, gauge, float(signal), high if low < 0 else None)
        return y

    def _lamps(self, draw: ImageDraw.ImageDraw, y: int, shot: Moment) -> int:
        x = _LEFT
        if "contact" in self._shapes:
            text = "in contact" if shot.contact else "no contact"
            self._lamp(draw, x, y, shot.contact, RED, text)
            x += 100
        if self._wanted:
            text = "in the spot" if shot.event else "off the spot"
            self._lamp(draw, x, y, shot.event, GREEN, text)
        return y + 48

    def _motors(self, draw: ImageDraw.ImageDraw, y: int, shot: Moment) -> int:
        y = self._heading(draw, y, "Motors")
        for name, motor in zip(("left", "right"), shot.motors, strict=True):
            y = self._gauge(draw, y, name, float(motor), 0.5)
        return y + 26

    def _total(self, draw: ImageDraw.ImageDraw, y: int, shot: Moment) -> int:
        y = self._heading(draw, y, "Time in the spot" if self._wanted else "Time in contact")
        draw.text((_LEFT, y + 6), f"{shot.event_seconds:.1f} s", _INK, self._large, "lm")
        share = shot.event_seconds / max(shot.time, CONTROL_TIMESTEP)
        draw.text((_RIGHT, y + 7), f"{min(share, 1):.1%}", _DIM, self._text, "rm")
        return y + 36

    def _timeline(self, draw: ImageDraw.ImageDraw, y: int, shot: Moment) -> int:
        def at(time: float) -> float:
            return _LEFT + (_RIGHT - _LEFT) * min(time / self._seconds, 1)

        draw.rectangle((_LEFT, y, _RIGHT, y + 12), _GROOVE)
        for start, end in self._events:
            draw.rectangle((at(start), y, at(end), y + 12), _hex(self._hot))
        draw.line((at(shot.time), y - 3, at(shot.time), y + 15), _INK, 2)
        return y + 30

    def _heading(self, draw: ImageDraw.ImageDraw, y: int, text: str) -> int:
        draw.text((_LEFT, y), text, _DIM, self._small, "lm")
        return y + 24

    def _gauge(
        self, draw: ImageDraw.ImageDraw, y: int, name: str, value: float, limit: float | None
    ) -> int:
        """Draws a value in [0, 1], or in [-limit, limit] with zero in the middle."""
        left, right = _LEFT + 42, WIDTH - 70
        text = f"{value:.3f}" if limit is None else f"{value:+.2f}"
        draw.text((_LEFT, y), name, _INK, self._text, "lm")
        draw.text((_RIGHT, y), text, _INK, self._figures, "rm")
        draw.rectangle((left, y - 4, right, y + 4), _GROOVE)
        if limit is None:
            tip = left + value * (right - left)
            draw.rectangle((left, y - 4, tip, y + 4), _hex(heat(value, self._hot)))
        else:
            centre = (left + right) / 2
            tip = centre + value / (2 * limit) * (right - left)
            draw.rectangle((min(centre, tip), y - 4, max(centre, tip), y + 4), _hex(BLUE))
            draw.line((centre, y - 7, centre, y + 7), _DIM)
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
    # The fonts of Matplotlib's package are the same on every machine.
    folder = Path(matplotlib.get_data_path()) / "fonts" / "ttf"
    return ImageFont.truetype(folder / f"DejaVuSans{family}{style}.ttf", size)
