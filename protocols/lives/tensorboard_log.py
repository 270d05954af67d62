"""`--log tensorboard`: the mean curve of each condition, in event files in `OUT/tensorboard`.

A log only reads what the run keeps: no result depends on it.
"""

from __future__ import annotations

import importlib
import time
from collections.abc import Callable, Generator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ..errors import InputError, missing_extra
from ..progress import JobProgress
from ..storage import check_own_folder
from ..terminal import notice
from .conditions import Condition
from .schedules import SCHEDULES

if TYPE_CHECKING:
    from .jobs import Executor, Job

FOLDER = "tensorboard"


def check_tensorboard() -> None:
    """Raises InputError if the extra `tensorboard` is not installed."""
    _module("tensorboard")


class TensorBoardLog:
    """Writes curves while their robots are simulated; an earlier call's log is continued.

    Each condition is a run of TensorBoard, named after its task, proposer and number of robots. It
    has one scalar, `contact` or `in_spot`: the mean share of a minute. A step is a simulated
    minute, counted from 1.
    """

    def __init__(
        self,
        folder: Path,
        robots: Mapping[Condition, int],
        curve: Callable[[Condition], np.ndarray],
        every: float,
    ) -> None:
        """Initialises the log; nothing is written yet.

        Args:
          folder: Folder of the log.
          robots: Number of robots of each condition.
          curve: Function that returns a condition's mean share of each simulated minute so far,
            shape (M,).
          every: Wall-clock seconds between two updates.
        """
        self._curve, self._every = curve, every
        self._folders = {
            condition: folder / f"{condition.task}-{condition.proposer}-{number}".replace(":", ".")
            for condition, number in robots.items()
        }
        self._written: dict[Condition, int] = {}  # minutes in the log
        self._writers: dict[Condition, Any] = {}
        self._updated = time.monotonic()
        self._failed = False

    def watching(self, executor: Executor) -> Executor:
        """Returns an executor that also updates the log: now and then, and after each job."""

        def run(jobs: Sequence[Job], progress: JobProgress) -> Generator[Job]:
            progress.watch(self._update_if_due)
            running = executor(jobs, progress)
            try:
                for job in running:
                    yield job
                    self.update()
            finally:
                running.close()

        return run

    def update(self) -> None:
        """Writes the minutes that are not in the log yet; a failure ends the log, not the run."""
        self._updated = time.monotonic()
        if self._failed:
            return
        try:
            for condition in self._folders:
                self._add(condition, self._curve(condition))
        except (OSError, InputError) as error:
            self._fail(error)

    def close(self) -> None:
        """Updates the log a last time, and closes its files."""
        self.update()
        for writer in self._writers.values():
            try:
                writer.close()
            except OSError as error:
                self._fail(error)

    def _update_if_due(self) -> None:
        if time.monotonic() - self._updated >= self._every:
            self.update()

    def _add(self, condition: Condition, curve: np.ndarray) -> None:
        folder = self._folders[condition]
        if condition not in self._written:
            for own in (folder.parent, folder):
                check_own_folder(own)
            self._written[condition] = _last_step(folder)
        first = self._written[condition]
        if len(curve) <= first:
            return
        if condition not in self._writers:
            writer = _module("torch.utils.tensorboard").SummaryWriter
            self._writers[condition] = writer(str(folder))
        writer = self._writers[condition]
        tag = "in_spot" if SCHEDULES[condition.task].wanted else "contact"
        for minute in range(first, len(curve)):
            writer.add_scalar(tag, curve[minute], minute + 1)
        writer.flush()
        self._written[condition] = len(curve)

    def _fail(self, error: Exception) -> None:
        if not self._failed:
            notice(f"the log of TensorBoard ends here ({error}); the run goes on")
        self._failed = True


def _module(name: str) -> Any:
    try:
        return importlib.import_module(name)  # optional: type checkers may not find it
    except ModuleNotFoundError as error:
        raise InputError(missing_extra(error)) from error


def _last_step(folder: Path) -> int:
    """Returns the last step of the events in a folder, 0 without any."""
    loader = _module("tensorboard.backend.event_processing.event_file_loader").EventFileLoader
    last = 0
    for path in folder.glob("events.out.tfevents.*"):
        for event in loader(str(path)).Load():
            last = max(last, event.step)
    return last
