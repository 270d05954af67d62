"""Progress with the remaining time, and notices, on stderr."""

from __future__ import annotations

import contextlib
import queue
import sys
import time
from collections.abc import Sequence
from typing import Any

from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn


def notice(sentence: str) -> None:
    """Prints a sentence on stderr."""
    print(f"musebot: {sentence}", file=sys.stderr)


def bar() -> Progress:
    """Returns a progress bar: description, share done, remaining time."""
    return Progress(
        TextColumn("{task.description}"),
        BarColumn(),
        TextColumn("{task.percentage:5.1f} %"),
        TextColumn("left"),
        TimeRemainingColumn(elapsed_when_finished=False),
        console=Console(stderr=True),
    )


class JobProgress:
    """Progress of several jobs together, with their speed, and the messages they send.

    A job's cost is its amount of work: simulated seconds, added up over the job's robots.
    """

    def __init__(self, what: str, costs: Sequence[float], quiet: bool = False) -> None:
        """Prepares the display.

        Args:
          what: Description of the jobs, shown next to the progress bar.
          costs: Cost of each job, in simulated seconds.
          quiet: Whether to show nothing.
        """
        self._done: dict[int, float] = {}
        self._first: dict[int, float] = {}  # the speed does not count earlier calls
        self._progress = Progress(
            TextColumn("{task.description}"),
            BarColumn(),
            TextColumn("{task.percentage:5.1f} %"),
            TextColumn("{task.fields[speed]}"),
            TimeElapsedColumn(),
            TextColumn("left"),
            TimeRemainingColumn(elapsed_when_finished=False),
            console=Console(stderr=True),
            disable=quiet,
            speed_estimate_period=300,
        )
        total = sum(costs)
        self._bar = self._progress.add_task(
            f"{what}, {total / 3600:,.0f} robot-hours", total=total, speed=""
        )
        self._began = time.monotonic()

    def __enter__(self) -> JobProgress:
        self._progress.start()
        return self

    def __exit__(self, *exception: object) -> None:
        self._progress.stop()

    def tell(self, sentence: str) -> None:
        """Prints a sentence above the bar."""
        self._progress.console.print(f"[yellow]{sentence}[/yellow]")

    def show(self, reports: Any) -> None:
        """Shows all reports in a queue: (number of the job, simulated seconds done, message)."""
        with contextlib.suppress(queue.Empty):
            while True:
                number, done, message = reports.get_nowait()
                if message:
                    self.tell(message)
                self._done[number] = done
                self._first.setdefault(number, done)
        done = sum(self._done.values())
        new = done - sum(self._first.values())
        speed = f"{new / (time.monotonic() - self._began):,.0f} x real time" if new else ""
        self._progress.update(self._bar, completed=done, speed=speed)
