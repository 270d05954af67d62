"""Progress with the remaining time, on stderr."""

from __future__ import annotations

import contextlib
import datetime
import queue
import sys
import time
from collections.abc import Callable, Sequence
from typing import Any

from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn
from rich.text import Text

from .terminal import notice, printable, say_if_possible

_FIRST, _MINUTE = 5.0, 60.0  # seconds to the first line of progress in a file; at most later
_DESCRIPTION = TextColumn("{task.description}", markup=False)


def _draws_bars() -> bool:
    """Returns whether stderr is a terminal that can draw a bar; else progress is lines of text."""
    with contextlib.suppress(AttributeError, ValueError):  # none, a replacement, or closed
        return sys.stderr.isatty() and not Console(stderr=True).is_dumb_terminal
    return False


class _Pace:
    """Times of the lines of progress in a file: 5, 10, 20, 40 and then 60 seconds apart."""

    def __init__(self) -> None:
        self._began, self._wait = time.monotonic(), _FIRST

    def due(self) -> bool:
        """Returns whether it is time for a line, and if so begins to wait for the next."""
        if (now := time.monotonic()) - self._began < self._wait:
            return False
        self._began, self._wait = now, min(2 * self._wait, _MINUTE)
        return True


class StepProgress:
    """Progress of steps of about equal length, in this process: a bar, or lines in a file."""

    def __init__(self, what: str, steps: int) -> None:
        """Takes a description and the number of the steps; nothing is shown for 0."""
        self._what, self._steps, self._done = printable(what), steps, 0
        self._lines = not _draws_bars()
        self._progress = Progress(
            _DESCRIPTION,
            BarColumn(),
            TextColumn("{task.percentage:5.1f} %"),
            TextColumn("left"),
            TimeRemainingColumn(elapsed_when_finished=False),
            console=Console(stderr=True),
            disable=self._lines or not steps,
        )
        self._bar = self._progress.add_task(self._what, total=steps)
        self._began, self._pace = time.monotonic(), _Pace()

    def __enter__(self) -> StepProgress:
        self._progress.start()
        return self

    def __exit__(self, *exception: object) -> None:
        self._progress.stop()

    def advance(self) -> None:
        """Counts a step."""
        self._done += 1
        self._progress.advance(self._bar)
        if self._lines and self._pace.due():
            seconds = (time.monotonic() - self._began) * (self._steps / self._done - 1)
            notice(f"{self._what}: {100 * self._done / self._steps:.1f} %, {remaining(seconds)}")


def remaining(seconds: float) -> str:
    """Returns a remaining time in words."""
    return f"{datetime.timedelta(seconds=max(round(seconds), 0))} left"


class JobProgress:
    """Progress of several jobs together, with their speed, and the messages they send.

    A job's cost is its amount of work: simulated seconds, added up over the job's robots. On a
    terminal a bar shows the progress; elsewhere, as in the log of a cluster, lines: the first after
    five seconds, the next ones at most a minute apart.
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
          costs: Cost of each job, in simulated seconds.
          quiet: Whether to show nothing.
          robots: Number of robots of each job; empty if the jobs are not made of robots' lives.
          watcher: Function that is called whenever reports are shown, several times a second.
        """
        self._costs, self._robots, self._watcher = costs, robots, watcher
        self._done: dict[int, float] = {}
        self._first: dict[int, float] = {}  # the speed does not count earlier calls
        self._lines = not (quiet or _draws_bars())
        self._progress = Progress(
            _DESCRIPTION,
            BarColumn(),
            TextColumn("{task.percentage:5.1f} %"),
            TextColumn("{task.fields[speed]}"),
            TimeElapsedColumn(),
            TextColumn("{task.fields[left]}"),
            console=Console(stderr=True),
            disable=quiet or self._lines,
        )
        total, hours = sum(costs), sum(costs) / 3600
        amount = f"{hours:,.0f}" if hours >= 10 else f"{hours:.2g}"
        self._what = f"{printable(what)}, {amount} robot-hours"
        self._bar = self._progress.add_task(self._what, total=total, speed="", left="")
        self._began, self._pace = time.monotonic(), _Pace()
        self._shown: float | None = None  # simulated seconds done at the last line

    def __enter__(self) -> JobProgress:
        self._progress.start()
        if self._lines:
            notice(self._what)
        return self

    def __exit__(self, *exception: object) -> None:
        self._progress.stop()
        if self._lines and self._shown != sum(self._done.values()):
            notice(self.line())

    def tell(self, sentence: str) -> None:
        """Prints a sentence above the bar."""
        if self._lines:
            say_if_possible(sentence)
        else:
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
        if self._lines and self._pace.due():
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

        Both follow the mean speed of this call.
        """
        done = sum(self._done.values())
        new = done - sum(self._first.values())
        seconds = time.monotonic() - self._began
        if not new > 0 or not seconds > 0:
            return done, "", ""
        speed = new / seconds
        left = remaining((sum(self._costs) - done) / speed)
        return done, f"{speed:,.0f} x real time", left
