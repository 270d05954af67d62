"""Films of episodes, seen from above, without a display."""

from __future__ import annotations

import contextlib
import dataclasses
import math
import os
import sys
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

import imageio_ffmpeg
import numpy as np

from ...tasks import CONTROL_TIMESTEP
from ...tasks.rules import Rules
from ..errors import InputError
from ..storage import check_place
from ..terminal import bar
from .episode import Episode, Moment
from .scene import HEIGHT, WIDTH, Panel, Shot, Stage

_TRAIL = 8.0  # seconds of the film after which the robot's trail has faded
_TRAIL_LIMIT = 90.0  # simulated seconds after which it has, however fast the film

# Half the size, one palette for the whole film: a page of text stays light.
_GIF = (
    "scale=iw/2:-2:flags=area,split[one][other];[one]palettegen=max_colors=48[palette];"
    "[other][palette]paletteuse=dither=none:diff_mode=rectangle"
)


@dataclasses.dataclass(frozen=True)
class Format:
    """How pictures become a file.

    Attributes:
      fps: pictures a second.
      encoder: keywords of `imageio_ffmpeg.write_frames`.
    """

    fps: int
    encoder: dict[str, Any]


FORMATS = {
    ".mp4": Format(
        25,
        {
            "codec": "libx264",
            "pix_fmt_out": "yuv420p",
            "output_params": ["-crf", "18", "-movflags", "+faststart"],
        },
    ),
    ".gif": Format(
        8,
        {
            "codec": "gif",
            "pix_fmt_out": "pal8",
            "output_params": ["-filter_complex", _GIF],
        },
    ),
}


def film(episode: Episode, output: Path, *, seconds: float, speed: float) -> None:
    """Films an episode from its start; the film ends with the episode at the latest.

    Args:
      episode: what to film; it is lived through once.
      output: the file, an .mp4 (H.264, yuv420p) or a .gif of half the size; an older one is
        replaced when the film is whole.
      seconds: length of the film, in seconds of the viewer's time.
      speed: simulated seconds in a second of the film.

    Raises:
      InputError: something of this makes no sense, cannot be written, or there is no EGL.
      OSError: the file could not be written; there is no half of it.
    """
    for name, value in (("length in seconds", seconds), ("speed", speed)):
        if not (value > 0 and math.isfinite(value)):
            raise InputError(f"the film's {name} must be positive, got {value:g}")
    fps = _check_output(output).fps
    frames = frame_count(seconds, speed, episode.seconds, fps)
    with contextlib.closing(Stage(episode.task)) as stage:
        _tell(f"drawing with {stage.renderer}")
        if frames < round(seconds * fps):
            _tell(
                f"the episode is over after {episode.seconds:g} s, and so is the film: "
                f"{frames / fps:g} s"
            )
        panel = Panel(
            episode.task, episode.driver, episode.trained, speed, seconds=frames * speed / fps
        )
        times = (frame * speed / fps for frame in range(frames))
        shots = _shots(episode.moments(), episode.batch.rules, times, speed)
        pictures = (panel.frame(stage.draw(shot), shot) for shot in shots)
        _write(output, pictures, frames)


def frame_count(seconds: float, speed: float, episode_seconds: float, fps: int) -> int:
    """How many frames a film has, which ends with the episode at the latest.

    Args:
      seconds: of the film, wanted.
      speed: simulated seconds in a second of the film.
      episode_seconds: simulated seconds that the episode lasts.
      fps: frames in a second of the film.
    """
    return max(1, round(min(seconds, episode_seconds / speed) * fps))


def _check_output(output: Path) -> Format:
    if output.suffix.lower() not in FORMATS:
        raise InputError(f"the film must be an .mp4 or a .gif file, got {output}")
    check_place(output)
    return FORMATS[output.suffix.lower()]


def _shots(
    moments: Iterator[Moment], rules: Rules, times: Iterable[float], speed: float
) -> Iterator[Shot]:
    """One shot a time; between two control steps the robot goes straight on."""
    past = [next(moments)]
    shown = 0  # moments up to which the frame before has shown what happened
    for time in times:
        while past[-1].time <= time and (moment := next(moments, None)) is not None:
            past.append(moment)
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
    pose = _between(moment.pose, after.pose, (time - moment.time) / span if span else 0.0)
    reach = min(_TRAIL * speed, _TRAIL_LIMIT)
    points = past[max(0, math.ceil((time - reach) / CONTROL_TIMESTEP)) : now + 1]
    # What happened between two frames must not be missed.
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


def _between(first: np.ndarray, second: np.ndarray, share: float) -> np.ndarray:
    """A pose on the way from one to another, turning the shorter way."""
    way = second - first
    way[2] = (way[2] + np.pi) % (2 * np.pi) - np.pi
    return first + share * way


def _write(output: Path, pictures: Iterator[np.ndarray], frames: int) -> None:
    suffix = output.suffix.lower()
    draft = output.with_name(f".{output.stem}.{os.getpid()}{suffix}")
    progress = bar()
    writer = imageio_ffmpeg.write_frames(
        draft,
        (WIDTH, HEIGHT),
        fps=FORMATS[suffix].fps,
        macro_block_size=2,
        ffmpeg_log_level="fatal",  # a failure shows in what is left, below
        **FORMATS[suffix].encoder,
    )
    try:
        with progress, contextlib.closing(writer):
            writer.send(None)  # type: ignore[arg-type] -- so it starts
            for picture in progress.track(pictures, frames, description=output.name):
                writer.send(np.ascontiguousarray(picture))
        _check_whole(draft, output, frames)
        draft.replace(output)
    finally:
        draft.unlink(missing_ok=True)


def _check_whole(draft: Path, output: Path, frames: int) -> None:
    # imageio_ffmpeg closes ffmpeg without asking whether it could write everything.
    try:
        written, _ = imageio_ffmpeg.count_frames_and_secs(draft)
    except RuntimeError:
        written = 0
    if written != frames:
        raise OSError(f"{output} could not be written whole; is the disk full?")


def _tell(sentence: str) -> None:
    print(f"musebot: {sentence}", file=sys.stderr)
