"""Films: a robot's stored brain sits a test again, seen from above, without a display."""

from __future__ import annotations

import contextlib
import math
import os
import sys
from collections.abc import Iterator
from pathlib import Path

import imageio.v2 as imageio
import imageio_ffmpeg
import numpy as np

from ..tasks import CONTROL_TIMESTEP
from ..tasks.arena import Rules
from .errors import InputError
from .picture import Panel, Shot, Stage
from .progress import bar
from .replay import Candidate, Moment, Reenactment
from .schedules import NAMES, SCHEDULES
from .storage import check_place

FPS = 25
_TRAIL = 8.0  # seconds of the film after which the robot's trail has faded
_TRAIL_LIMIT = 90.0  # simulated seconds after which it has, however fast the film


def film(candidate: Candidate, output: Path, *, seconds: float, speed: float) -> None:
    """Films a robot's stored brain as it sits a test again, from the test's start.

    The brain neither learns nor explores, as in the test. Its noise is drawn anew: the film
    shows what this brain does, not to the bit what it did. It ends with the first stretch of
    the test at the latest.

    Args:
      candidate: who sits which test.
      output: the file, an .mp4 (H.264, yuv420p); an older one is replaced when the film is
        whole.
      seconds: length of the film, in seconds of the viewer's time.
      speed: simulated seconds in a second of the film.

    Raises:
      InputError: something of this makes no sense, cannot be written, or there is no EGL.
      OSError: the file could not be written; there is no half of it.
    """
    for name, value in (("length in seconds", seconds), ("speed", speed)):
        if not (value > 0 and math.isfinite(value)):
            raise InputError(f"the film's {name} must be positive, got {value:g}")
    test = Reenactment(candidate)
    _check_output(output)
    frames = frame_count(seconds, speed, test.seconds)
    with contextlib.closing(Stage(test.batch.rules, test.batch.spot[0])) as stage:
        _tell(f"drawing with {stage.renderer}")
        if frames < round(seconds * FPS):
            _tell(
                f"the test is over after {test.seconds:g} s, and so is the film: {frames / FPS:g} s"
            )
        panel = Panel(
            NAMES[candidate.task],
            f"{candidate.proposer} proposer, robot {candidate.robot}",
            after=candidate.phase == "post",
            wanted=SCHEDULES[candidate.task].wanted,
            speed=speed,
            seconds=frames * speed / FPS,
        )
        shots = _shots(test.moments(), test.batch.rules, frames, speed)
        pictures = (panel.frame(stage.draw(shot), shot) for shot in shots)
        _write(output, pictures, frames)


def frame_count(seconds: float, speed: float, test_seconds: float) -> int:
    """How many frames a film has, which ends with the test at the latest.

    Args:
      seconds: of the film, wanted.
      speed: simulated seconds in a second of the film.
      test_seconds: simulated seconds that the test lasts.
    """
    return max(1, round(min(seconds, test_seconds / speed) * FPS))


def _check_output(output: Path) -> None:
    if output.suffix.lower() != ".mp4":
        raise InputError(f"the film must be an .mp4 file, got {output}")
    check_place(output)


def _shots(moments: Iterator[Moment], rules: Rules, frames: int, speed: float) -> Iterator[Shot]:
    """One shot a frame; between two control steps the robot goes straight on."""
    past = [next(moments)]
    shown = 0  # moments up to which the frame before has shown what happened
    for frame in range(frames):
        time = frame * speed / FPS
        while past[-1].time <= time and (moment := next(moments, None)) is not None:
            past.append(moment)
        now = max(0, len(past) - 2)
        if past[-1].time <= time:  # the test is over
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
    signals = rules.observations(moment.sensordata)
    # What happened between two frames must not be missed.
    event = any(m.event for m in past[min(shown + 1, now) : now + 1])
    return Shot(
        time,
        pose,
        signals,
        moment.motors,
        event,
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
    draft = output.with_name(f".{output.stem}.{os.getpid()}.mp4")
    progress = bar()
    try:
        with (
            progress,
            imageio.get_writer(
                draft,
                format="FFMPEG",  # type: ignore[arg-type]
                fps=FPS,
                codec="libx264",
                pixelformat="yuv420p",
                macro_block_size=2,
                ffmpeg_log_level="fatal",  # a failure shows in what is left, below
                output_params=["-crf", "18", "-movflags", "+faststart"],
            ) as writer,
        ):
            for picture in progress.track(pictures, frames, description=output.name):
                writer.append_data(picture)  # type: ignore[attr-defined]
        _check_whole(draft, output, frames)
        draft.replace(output)
    finally:
        draft.unlink(missing_ok=True)


def _check_whole(draft: Path, output: Path, frames: int) -> None:
    # imageio closes ffmpeg without asking whether it could write everything.
    try:
        written, _ = imageio_ffmpeg.count_frames_and_secs(draft)
    except RuntimeError:
        written = 0
    if written != frames:
        raise OSError(f"{output} could not be written whole; is the disk full?")


def _tell(sentence: str) -> None:
    print(f"musebot: {sentence}", file=sys.stderr)
