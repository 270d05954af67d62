"""Films of episodes from above, rendered without a display."""

from __future__ import annotations

import contextlib
import dataclasses
import math
import signal
import tempfile
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

import imageio.v2 as imageio
import numpy as np

from ...tasks import CONTROL_TIMESTEP
from ...tasks.rules import Rules
from ..errors import InputError
from ..lives.stop_requests import handling
from ..storage import check_place, remove_drafts, resolved_file, write_atomically
from ..terminal import StepProgress, notice
from .episode import Episode, Moment
from .panel import Panel
from .scene import Scene, Shot

_ROUNDING = 1e-6  # [s], of the times of frames and of control steps
_TRAIL = 8.0  # [s] of the film, after which the robot's trail has faded
_LONGEST = 3600  # [s], of a film
_TRAIL_LIMIT = 90.0  # simulated [s] after which it has faded at any speed of the film

# Half the size and one palette for the whole film keep the file small.
_GIF = (
    "scale=iw/2:-2:flags=area,split[one][other];[one]palettegen=max_colors=48[palette];"
    "[other][palette]paletteuse=dither=none:diff_mode=rectangle"
)


@dataclasses.dataclass(frozen=True)
class Format:
    """File format of a film.

    Attributes:
      fps: Frames per second of the film.
      encoder: Options for imageio's FFMPEG writer.
    """

    fps: int
    encoder: dict[str, Any]


FORMATS = {
    ".mp4": Format(
        25,
        {
            "codec": "libx264",
            "pixelformat": "yuv420p",
            "output_params": ["-crf", "18", "-movflags", "+faststart"],
        },
    ),
    ".gif": Format(
        8,
        {
            "codec": "gif",
            "pixelformat": "pal8",
            "output_params": ["-f", "gif", "-filter_complex", _GIF],
        },
    ),
}


def film(episode: Episode, output: Path, *, seconds: float, speed: float) -> None:
    """Films an episode from its start, until its end or its last stable step at the latest.

    Args:
      episode: Episode to film; it is simulated once.
      output: File to write, an .mp4 (H.264, yuv420p) or a .gif of half the width and height; an
        existing file is replaced when the film is complete.
      seconds: Requested length of the film in [s].
      speed: Simulated seconds per second of the film.

    Raises:
      InputError: a value is invalid, the file cannot be written, or there is no EGL.
      OSError: the film could not be written completely; the partial film is deleted.
    """
    for name, value in (("length in seconds", seconds), ("speed", speed)):
        if not (value > 0 and math.isfinite(value)):
            raise InputError(f"the film's {name} must be positive, got {value:g}")
    if seconds > _LONGEST:
        raise InputError(f"the film must last at most {_LONGEST} s, got {seconds:g}")
    output = resolved_file(output)
    fps = _check_output(output).fps
    count = frame_count(seconds, speed, episode.seconds, fps)
    with contextlib.closing(Scene(episode.task, episode.batch.dimensions)) as scene:
        notice(f"drawing with {scene.renderer}")
        if count < round(seconds * fps):
            notice(f"the episode lasts {episode.seconds:g} s, so the film lasts {count / fps:g} s")
        panel = Panel(
            episode.task, episode.driver, episode.trained, speed, seconds=count * speed / fps
        )
        times = (number * speed / fps for number in range(count))
        shots = shots_at(times, episode.moments(), episode.batch.rules, speed)
        written = write(output, (panel.frame(scene.draw(shot), shot) for shot in shots), count)
    if written < count:
        notice(f"the simulation became unstable: the film ends there, after {written / fps:g} s")


def frame_count(seconds: float, speed: float, episode_seconds: float, fps: int) -> int:
    """Returns the number of frames of a film that ends with the episode at the latest.

    Args:
      seconds: Requested length of the film in [s].
      speed: Simulated seconds per second of the film.
      episode_seconds: Simulated duration of the episode in [s].
      fps: Frames per second of the film.
    """
    return max(1, round(min(seconds, episode_seconds / speed) * fps))


def shots_at(
    times: Iterable[float], moments: Iterator[Moment], rules: Rules, speed: float
) -> Iterator[Shot]:
    """Yields the content of the frame at each time; poses are interpolated between control steps.

    It ends at the first time after the last moment, from which on nothing was simulated.

    Args:
      times: Simulated times in [s], ascending.
      moments: Moments of the episode, in order.
      rules: Rules of the episode's task.
      speed: Simulated seconds per second of the film.
    """
    past = [next(moments)]
    shown = 0  # index of the last moment in the frame before
    for time in times:
        while past[-1].time <= time and (moment := next(moments, None)) is not None:
            past.append(moment)
        if past[-1].time < time - _ROUNDING:  # the simulation became unstable
            return
        now = max(0, len(past) - 2)
        if past[-1].time <= time:  # the episode is over
            now = len(past) - 1
        yield _shot(past, now, shown, time, rules, speed)
        shown = now


def _shot(
    past: list[Moment], now: int, shown: int, time: float, rules: Rules, speed: float
) -> Shot:
    moment, after = past[now], past[min(now + 1, len(past) - 1)]
    span = after.time - moment.time
    pose = between(moment.pose, after.pose, (time - moment.time) / span if span else 0.0)
    reach = min(_TRAIL * speed, _TRAIL_LIMIT)
    points = past[max(0, math.ceil((time - reach) / CONTROL_TIMESTEP)) : now + 1]
    # A frame also shows the events since the frame before.
    unseen = past[min(shown + 1, now) : now + 1]
    return Shot(
        time,
        pose,
        moment.spot,
        rules.observations(moment.sensordata),
        moment.motors,
        any(m.sensordata[rules.layout.touch] > 0 for m in unseen),
        any(m.event for m in unseen),
        moment.event_seconds,
        np.array([*(m.pose[:2] for m in points), pose[:2]]),
        np.array([*(m.event for m in points), after.event]),
        np.clip([*((time - m.time) / reach for m in points), 0.0], 0, 1),
    )


def between(first: np.ndarray, second: np.ndarray, share: float) -> np.ndarray:
    """Interpolates between two poses; the heading turns the shorter way.

    Args:
      first: x, y in [m] and heading in [rad] of the first pose, shape (3,).
      second: x, y in [m] and heading in [rad] of the second pose, shape (3,).
      share: Share of the way from the first to the second pose, in [0, 1].
    """
    way = second - first
    way[2] = (way[2] + np.pi) % (2 * np.pi) - np.pi
    return first + share * way


def write(output: Path, frames: Iterable[np.ndarray], count: int) -> int:
    """Writes frames into a film; an existing file is replaced when the film is complete.

    Args:
      output: File to write; its suffix is one of `FORMATS`.
      frames: Pixels of each frame, uint8, shape (height, width, 3), with even height and width.
      count: Number of frames, at most, for the display of progress.

    Returns:
      Number of frames.

    Raises:
      OSError: the film could not be written completely; the partial film is deleted.
    """
    suffix = output.suffix.lower()
    with (
        handling(_interrupt, signal.SIGTERM),
        tempfile.TemporaryDirectory(prefix="musebot-") as folder,
    ):
        # imageio's FFMPEG writer refuses names that end in .gif.
        draft = Path(folder) / "film.mp4"
        writer: Any = imageio.get_writer(
            draft,
            "FFMPEG",
            fps=FORMATS[suffix].fps,
            macro_block_size=2,
            ffmpeg_log_level="fatal",  # the number of frames shows a failure, see below
            **FORMATS[suffix].encoder,
        )
        given = 0
        with StepProgress(output.name, count) as progress, writer:
            for frame in frames:
                given += 1
                if not _append(writer, frame):
                    break
                progress.advance()
        # imageio does not check whether ffmpeg could write everything.
        if _frames_in(draft) != given:
            raise OSError(f"{output} could not be written completely; is the disk full?")
        remove_drafts(output.parent, output.name)  # of a film that was killed
        write_atomically(output, draft.read_bytes())
        return given


def _interrupt(number: int, frame: object) -> None:
    """Turns a signal into Ctrl-C, after which nothing is left."""
    del number, frame
    raise KeyboardInterrupt


def _append(writer: Any, frame: np.ndarray) -> bool:
    """Appends a frame; returns False if ffmpeg has ended, for example because the disk is full."""
    try:
        writer.append_data(frame)
    except OSError:
        return False
    return True


def _frames_in(path: Path) -> int:
    """Returns the number of frames in a film; 0 for a file that is not a film."""
    try:
        reader: Any = imageio.get_reader(path, "FFMPEG")
        with reader:
            return reader.count_frames()
    except (OSError, RuntimeError):
        return 0


def _check_output(output: Path) -> Format:
    if output.suffix.lower() not in FORMATS:
        raise InputError(f"the film must be an .mp4 or a .gif file, got {output}")
    check_place(output)
    return FORMATS[output.suffix.lower()]
