"""Displays progress and the remaining time on stderr."""

from __future__ import annotations

import contextlib
import datetime
import queue
import sys
import time
from collections.abc import Callable, Iterable, Sequence, Sized
from typing import Any, TypeVar

from rich.console import Console
from rich.markup import escape
from rich.progress import BarColumn, Progress, TextColumn, track
from rich.text import Text

from .terminal import notice, printable, say_if_possible

Step = TypeVar("Step")

# Seconds until the first line where there is no bar; then the pause doubles, up to a minute.
_FIRST, _MINUTE = 5.0, 60.0


def _draws_bars() -> bool:
    """Returns whether stderr is a terminal that can draw a bar."""
    with contextlib.suppress(AttributeError, ValueError):  # stderr is None, replaced, or closed
        return sys.stderr.isatty() and not Console(stderr=True).is_dumb_terminal
    return False


class _Lines:
    """Decides when a log gets lines of progress."""

    def __init__(self) -> None:
        self._pause, self._due = _FIRST, time.monotonic() + _FIRST

    def due(self) -> bool:
        """Returns whether a line is due now; if so, plans the next one."""
        if (now := time.monotonic()) < self._due:
            return False
        self._pause = min(2 * self._pause, _MINUTE)
        self._due = now + self._pause
        return True


def tracked(steps: Iterable[Step], what: str, count: int | None = None) -> Iterable[Step]:
    """Yields steps that take about equal times; shows a bar, or lines where there is no terminal.

    `what` describes the steps. `count` is their number; None if `steps` has a length.
    """
    if _draws_bars():
        yield from track(steps, escape(printable(what)), count, console=Console(stderr=True))
        return
    lines, began = _Lines(), time.monotonic()
    if count is None and isinstance(steps, Sized):
        count = len(steps)
    for done, step in enumerate(steps):
        if done and count and lines.due():
            left = _duration((time.monotonic() - began) * (count - done) / done)
            notice(f"{printable(what)}: {100 * done / count:.1f} %, {left} left")
        yield step


def _duration(seconds: float) -> str:
    return str(datetime.timedelta(seconds=max(round(seconds), 0)))


class JobProgress:
    """Displays the progress of several jobs together, their speed, and the messages they send.

    A job's cost is its amount of work: simulated seconds, added up over the job's robots. On a
    terminal, a bar shows the progress. Elsewhere, as in the log of a cluster, lines show it: the
    first after five seconds, the next ones at most a minute apart.
    """

    def __init__(
        self,
        what: str,
        costs: Sequence[float],
        quiet: bool = False,
        robots: Sequence[int] = (),
        watcher: Callable[[], None] = lambda: None,
    ) -> None:
        """Prepares the display.

        Args:
          what: Description of the jobs, shown next to the progress.
          costs: Cost of each job: simulated seconds, added up over its robots.
          quiet: Whether to hide the progress; messages are shown.
          robots: Number of robots in each job. If given, progress lines count robots, else jobs.
          watcher: Function without arguments, called at the end of every call of `show`.
        """
        self._costs, self._robots, self._watcher = costs, robots, watcher
        self._done: dict[int, float] = {}
        self._first: dict[int, float] = {}  # done by earlier commands; no part of the speed
        self._log = not (quiet or _draws_bars())
        self._progress = Progress(
            TextColumn("{task.description}", markup=False),
            BarColumn(),
            TextColumn("{task.percentage:5.1f} %"),
            TextColumn("{task.fields[speed]}"),
            TextColumn("{task.fields[left]}"),
            console=Console(stderr=True),
            disable=quiet or self._log,
        )
        total, hours = sum(costs), sum(costs) / 3600
        amount = f"{hours:,.0f}" if hours >= 10 else f"{hours:.2g}"
        self._what = f"{printable(what)}, {amount} robot-hours"
        self._bar = self._progress.add_task(self._what, total=total, speed="", left="")
        self._began, self._lines = time.monotonic(), _Lines()
        self._shown: float | None = None  # simulated seconds done at the last line

    def __enter__(self) -> JobProgress:
        self._progress.start()
        if self._log:
            notice(self._what)
        return self

    def __exit__(self, *exception: object) -> None:
        with contextlib.suppress(OSError, ValueError):  # the terminal has gone
            self._progress.stop()
        if self._log and self._shown != sum(self._done.values()):
            notice(self.line())

    def tell(self, sentence: str) -> None:
        """Prints a message, above the bar if there is one."""
        if self._progress.disable:
            say_if_possible(sentence)
        else:
            with contextlib.suppress(OSError, ValueError):
                self._progress.console.print(Text(printable(sentence), "yellow"))

    def show(self, reports: Any) -> None:
        """Shows all reports in a queue: (number of the job, simulated seconds done, message)."""
        with contextlib.suppress(queue.Empty):
            while True:
                number, done, message = reports.get_nowait()
                if message:
                    self.tell(message)
                self._done[number] = done
                self._first.setdefault(number, done)
        done, speed, left = self._state()
        self._progress.update(self._bar, completed=done, speed=speed, left=left)
        if self._log and self._lines.due():
            notice(self.line())
            self._shown = done
        self._watcher()

    def line(self) -> str:
        """Returns the progress in words: share and robots done, speed, remaining time."""
        done, speed, left = self._state()
        finished = [n for n, cost in enumerate(self._costs) if self._done.get(n, 0) >= cost]
        share = f"{100 * done / (sum(self._costs) or 1):.1f} %"
        jobs = f"{len(finished)} of {len(self._costs)} jobs done"
        if self._robots:
            robots = sum(self._robots[number] for number in finished)
            jobs = f"{robots} of {sum(self._robots)} robots done"
        return ", ".join(filter(None, [share, jobs, speed, left]))

    def _state(self) -> tuple[float, str, str]:
        """Returns the simulated seconds done, the speed in words and the remaining time in words.

        Speed and remaining time follow from the mean speed since this display began.
        """
        done = sum(self._done.values())
        new = done - sum(self._first.values())
        seconds = time.monotonic() - self._began
        if not new > 0 or not seconds > 0:
            return done, "", ""
        speed = new / seconds
        left = _duration((sum(self._costs) - done) / speed)
        return done, f"{speed:,.0f} x real time", f"{left} left"
