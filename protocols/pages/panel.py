"""The parts of a film's frame around the scene: title, clock, sensor signals and motors."""

from __future__ import annotations

from pathlib import Path

import matplotlib
import numpy as np
from matplotlib.colors import to_hex
from PIL import Image, ImageDraw, ImageFont

from ...tasks import CONTROL_TIMESTEP
from ...tasks.rules import RANGEFINDERS
from ...tasks.suite import TASKS
from . import scene
from .replay import BEFORE, Episode, Moment, Relived
from .scene import AMBER, BLUE, GREEN, RED, heat

_HEADER, _PANEL = 44, 240
WIDTH, HEIGHT = scene.WIDTH + _PANEL, scene.HEIGHT + _HEADER  # [pixels]; H.264 needs even numbers

# Title and gauges of each sensor signal.
_GAUGES = {
    "nose": ("nose", ("smell",)),
    "noses": ("nose", ("left", "right")),
    "distances": ("distance", RANGEFINDERS),
    "speed": ("speed", ("ahead",)),
    "contact": ("contact", ("contact",)),
}
_LEFT, _RIGHT = scene.WIDTH + 20, WIDTH - 20  # edges of the panel's content
_TIMELINE = HEIGHT - 40
_INK, _DIM, _GROOVE, _BACK, _HEAD = "#f2f4f7", "#98a2b1", "#39414f", "#1f252f", "#161b23"


class Panel:
    """Draws a film's frame: a header above the scene and a panel of instruments to its right."""

    def __init__(self, episode: Episode | Relived, speed: float, seconds: float) -> None:
        """Draws the parts that all frames of an episode share.

        `speed` is the simulated seconds per second of the film, and `seconds` its simulated
        duration in [s].
        """
        task, driver, when = episode.task, episode.driver, episode.when
        self._shapes = TASKS[task].rules.shapes
        self._event = episode.event
        self._hot = RED if self._event == "in contact" else GREEN
        self._seconds, self._seen, self._counted = seconds, 0.0, 0.0
        self._small, self._text, self._figures = _font(11), _font(13), _font(12, "", "Mono")
        self._large, self._digits = _font(22, "-Bold"), _font(30, "-Bold", "Mono")
        self._blank = Image.new("RGB", (WIDTH, HEIGHT), _BACK)
        draw, title, bold = ImageDraw.Draw(self._blank), task.replace("_", " "), _font(17, "-Bold")
        draw.rectangle((0, 0, WIDTH, _HEADER - 1), fill=_HEAD)
        draw.text((20, 22), title.capitalize(), _INK, bold, "lm")
        draw.text((34 + bold.getlength(title.capitalize()), 23), driver, _DIM, _font(14), "lm")
        colour = to_hex(AMBER if when == BEFORE else GREEN)
        draw.text((_RIGHT, 22), when, colour, _font(13, "-Bold"), "rm")
        speeds = f"{speed:g} \N{MULTIPLICATION SIGN} real time"
        draw.text((_RIGHT, _HEADER + 24), speeds, _DIM, self._small, "rm")
        draw.rectangle((_LEFT, _TIMELINE, _RIGHT, _TIMELINE + 12), _GROOVE)

    def frame(self, image: np.ndarray, shot: Moment) -> np.ndarray:
        """Returns a frame, uint8, shape (HEIGHT, WIDTH, 3), around an image of the scene.

        The image is uint8, shape (scene.HEIGHT, scene.WIDTH, 3). The instruments show
        `shot`. The timeline shows all events up to `shot`, also those since the last frame.
        """
        begun, now = (
            _LEFT + (_RIGHT - _LEFT) * min(time / self._seconds, 1)
            for time in (self._seen, shot.time)
        )
        if shot.event_seconds > self._counted:
            event = begun, _TIMELINE, now, _TIMELINE + 12
            ImageDraw.Draw(self._blank).rectangle(event, to_hex(self._hot))
        self._seen, self._counted = shot.time, shot.event_seconds
        frame = self._blank.copy()
        frame.paste(Image.fromarray(image), (0, _HEADER))
        draw = ImageDraw.Draw(frame)
        draw.line((now, _TIMELINE - 3, now, _TIMELINE + 15), _INK, 2)

        y = self._heading(draw, _HEADER + 24, "Simulated time")
        minutes, seconds = divmod(int(10 * shot.time + 0.5), 600)
        clock = f"{minutes:02d}:{seconds / 10:04.1f}"
        draw.text((_LEFT - 1, y + 6), clock, _INK, self._digits, "lm")
        names = [name for name in self._shapes if name in _GAUGES]
        words = " and ".join(_GAUGES[name][0] for name in names)
        y = self._heading(draw, y + 60, f"{words.capitalize()} signals")
        for name in names:
            _, low, high = self._shapes[name]
            signals = [shot.contact] if name == "contact" else shot.signals[name]
            limit = high if low < 0 and name != "contact" else None
            for gauge, signal in zip(_GAUGES[name][1], signals, strict=True):
                y = self._gauge(draw, y, gauge, float(signal), limit)
        y = self._heading(draw, y + 22, "Motors")
        for name, motor in zip(("left", "right"), shot.motors, strict=True):
            y = self._gauge(draw, y, name, float(motor), 0.5)
        y = self._heading(draw, y + 26, f"Time {self._event}")
        draw.text((_LEFT, y + 6), f"{shot.event_seconds:.1f} s", _INK, self._large, "lm")
        share = shot.event_seconds / max(shot.time, CONTROL_TIMESTEP)
        draw.text((_RIGHT, y + 7), f"{min(share, 1):.1%}", _DIM, self._text, "rm")
        return np.asarray(frame)

    def _heading(self, draw: ImageDraw.ImageDraw, y: int, text: str) -> int:
        """Draws a heading; returns the y coordinate below it."""
        draw.text((_LEFT, y), text, _DIM, self._small, "lm")
        return y + 24

    def _gauge(
        self, draw: ImageDraw.ImageDraw, y: int, name: str, value: float, limit: float | None
    ) -> int:
        """Draws a value in [0, 1], or [-limit, limit] around 0; returns the y below it."""
        left, right = _LEFT + 52, WIDTH - 70
        text = f"{value:.3f}" if limit is None else f"{value:+.2f}"
        draw.text((_LEFT, y), name, _INK, self._text, "lm")
        draw.text((_RIGHT, y), text, _INK, self._figures, "rm")
        draw.rectangle((left, y - 4, right, y + 4), _GROOVE)
        zero, colour = (
            (left, heat(value, self._hot)) if limit is None else ((left + right) / 2, BLUE)
        )
        tip = zero + value * (right - left) / (2 * limit if limit else 1)
        draw.rectangle((min(zero, tip), y - 4, max(zero, tip), y + 4), to_hex(colour))
        draw.line((zero, y - 7, zero, y + 7), _DIM)
        return y + 26


def _font(size: int, style: str = "", family: str = "") -> ImageFont.FreeTypeFont:
    # The fonts of Matplotlib's package are the same on every machine.
    folder = Path(matplotlib.get_data_path()) / "fonts" / "ttf"
    return ImageFont.truetype(folder / f"DejaVuSans{family}{style}.ttf", size)
