"""Films of episodes from above, rendered without a display."""

from __future__ import annotations

import collections
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
from ..errors import InputError
from ..progress import tracked
from ..runs.local import END_SIGNALS, handling
from ..storage import checked_file, remove_drafts, write_atomically
from ..terminal import notice
from .panel import Panel
from .replay import Episode, Moment, Relived
from .scene import JUMP, Scene, Trail

_ROUNDING = 1e-6  # [s], rounding error of the times of frames and control steps
_TRAIL = 8.0  # [s] of the film, after which the robot's trail has faded
_LEAST = 0.001  # length in [s], and speed
_TRAIL_LIMIT = 90.0  # simulated [s] after which the trail has faded at any speed

# Half the size and one palette for the whole film keep the file small.
_GIF = (
    "scale=iw/2:-2:flags=area,split[one][other];[one]palettegen=max_colors=48[palette];"
    "[other][palette]paletteuse=dither=none:diff_mode=rectangle"
)
_FPS = {".mp4": 25, ".gif": 8}
# Codec, format of pixels and further options of ffmpeg.
_ENCODERS = {
    ".mp4": ("libx264", "yuv420p", ["-crf", "18", "-movflags", "+faststart"]),
    ".gif": ("gif", "pal8", ["-f", "gif", "-filter_complex", _GIF]),
}


def film(
    episodes: Iterable[Episode | Relived], output: Path, *, seconds: float, speed: float
) -> None:
    """Films episodes from their starts, at most until one ends or becomes unstable.

    The film, an .mp4 (H.264, yuv420p) or a .gif of half the width and height, lasts `seconds` [s].
    It shows the episodes, all of one task, side by side; they are made only after all other values
    have been checked. `speed` is the simulated seconds per second of the film. An existing file is
    replaced when the film is complete.

    Raises:
      InputError: a value is invalid, the file cannot be written, or there is no EGL.
      OSError: the film could not be written completely; the partial film is deleted.
    """
    for name, value, most in ("length in seconds", seconds, 3600), ("speed", speed, 1e9):
        if not _LEAST <= value <= most:
            raise InputError(f"the film's {name} must lie in [{_LEAST:g}, {most:g}], got {value:g}")
    output = checked_file(output)
    if output.suffix.lower() not in _FPS:
        raise InputError(f"the film must be an .mp4 or a .gif file, got {output}")
    fps, episodes = _FPS[output.suffix.lower()], [*episodes]
    longest = min(episode.seconds for episode in episodes)
    count = max(1, round(min(seconds, longest / speed) * fps))
    times, first = np.arange(count) * speed / fps, episodes[0]
    with contextlib.closing(Scene(first.task, first.batch.dimensions)) as scene:
        notice(f"drawing with {scene.renderer}")
        if count < round(seconds * fps):
            notice(f"the episode lasts {longest:g} s, so the film lasts {count / fps:g} s")

        def drawn(episode: Episode | Relived) -> Iterator[np.ndarray]:
            panel = Panel(episode, speed, count * speed / fps)
            for shot, trail in shots_at(times, episode.moments(), speed):
                yield panel.frame(scene.draw(shot, trail), shot)

        together = zip(*map(drawn, episodes), strict=False)  # until the first ends
        frames = (np.hstack(parts) for parts in together)
        written = write(output, frames, count)
    if written < count:
        notice(f"the simulation became unstable: the film ends there, after {written / fps:g} s")


def shots_at(
    times: Iterable[float], moments: Iterator[Moment], speed: float
) -> Iterator[tuple[Moment, Trail]]:
    """Yields what the frame at each time shows; poses are interpolated between control steps.

    All values but pose and time are those of the preceding control step. If the simulation becomes
    unstable, the frames end at its last moment. `times` are in [s], ascending; `speed` is the
    simulated seconds per second of the film.
    """
    most = math.ceil(_TRAIL_LIMIT / CONTROL_TIMESTEP) + 2  # moments of the trail and around a frame
    past = collections.deque([next(moments)], most)
    for time in times:
        while past[-1].time <= time and (moment := next(moments, None)) is not None:
            past.append(moment)
        if past[-1].time < time - _ROUNDING:  # the simulation became unstable
            return
        after = past[-1]
        moment = after if after.time <= time else past[-2]  # `after`: the episode is over
        way = after.pose - moment.pose
        if np.hypot(*way[:2]) > JUMP:
            way[:] = 0
        way[2] = (way[2] + np.pi) % (2 * np.pi) - np.pi  # the heading turns the shorter way
        span = (after.time - moment.time) or 1.0
        pose = moment.pose + (time - moment.time) / span * way
        shot = dataclasses.replace(moment, time=time, pose=pose)
        yield shot, _trail(past, shot, after.event, speed)


def _trail(past: Iterable[Moment], shot: Moment, event: bool, speed: float) -> Trail:
    """Returns the trail through past moments to a shot; `event` is that of its last stretch."""
    time, reach = shot.time, min(_TRAIL * speed, _TRAIL_LIMIT)
    first = math.ceil((time - reach) / CONTROL_TIMESTEP) * CONTROL_TIMESTEP
    points = [m for m in past if first - _ROUNDING < m.time <= time]
    return Trail(
        np.array([*(m.pose[:2] for m in points), shot.pose[:2]]),
        np.array([*(m.event for m in points), event]),
        np.clip([*((time - m.time) / reach for m in points), 0.0], 0, 1),
    )


def write(output: Path, frames: Iterable[np.ndarray], count: int) -> int:
    """Writes frames into a film; an existing file is replaced when the film is complete.

    Frames are pixels, uint8, shape (height, width, 3), with even height and width. `count` is the
    largest number of frames, for the display of progress; the actual number is returned.

    Raises:
      OSError: the film could not be written completely; the partial film is deleted.
    """
    suffix = output.suffix.lower()
    codec, pixels, options = _ENCODERS[suffix]
    with (
        handling(signal.default_int_handler, *END_SIGNALS),  # like Ctrl-C, so that no draft is left
        tempfile.TemporaryDirectory(prefix="musebot-") as folder,
    ):
        draft = Path(folder) / "film.mp4"  # imageio's FFMPEG writer refuses names in .gif
        writer: Any = imageio.get_writer(
            draft, "FFMPEG", fps=_FPS[suffix], codec=codec, pixelformat=pixels,
            output_params=options, macro_block_size=2,
            ffmpeg_log_level="fatal",  # the number of frames shows a failure, see below
        )  # fmt: skip
        given = 0
        with writer:
            for frame in tracked(frames, output.name, count):
                given += 1
                try:
                    writer.append_data(frame)
                except OSError:  # ffmpeg has ended, for example because the disk is full
                    break
        # imageio does not check whether ffmpeg could write everything.
        if _frames_in(draft) != given:
            raise OSError(f"{output} could not be written completely; is the disk full?")
        remove_drafts(output.parent, output.name)  # of a process that was killed
        write_atomically(output, draft.read_bytes())
        return given


def _frames_in(path: Path) -> int:
    """Returns the number of frames in a film; 0 for a file that is not a film."""
    try:
        reader: Any = imageio.get_reader(path, "FFMPEG")
        with reader:
            return reader.count_frames()
    except (OSError, RuntimeError):
        return 0
