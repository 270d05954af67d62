"""Jobs of studies: their files, their progress in simulated minutes, and how they stop."""

from __future__ import annotations

import abc
import functools
import json
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import DamagedFileError
from ..lives.cohort import Cohort
from ..lives.conditions import Condition
from ..lives.experiment import Experiment, flat
from ..lives.jobs import Job, Report, Stop
from ..lives.run import check_same_shapes
from ..lives.schedules import control_steps
from ..storage import Shapes, load_arrays, save_arrays

SAVE_EVERY = 60.0  # wall-clock seconds between two checkpoints
_CHUNK = control_steps(1)


class StoppedError(Exception):
    """A job was asked to stop before it was done."""


class FileJob(abc.ABC):
    """A job that writes one file, when all its work is done.

    Attributes:
      path: File to which the result is written.
    """

    path: Path

    @property
    @abc.abstractmethod
    def identity(self) -> dict[str, Any]:
        """Notes by which the job recognises its file, as plain data."""

    @abc.abstractmethod
    def work(self, stop: Stop, report: Report) -> dict[str, np.ndarray]:
        """Does the work, from its beginning, and returns the arrays of the file; see `Job.run`.

        Raises:
          StoppedError: the job is asked to stop.
        """

    def done(self) -> bool:
        """See `Job.done`."""
        return self.path.exists()

    def run(self, stop: Stop, report: Report) -> bool:
        """See `Job.run`."""
        try:
            arrays = self.work(stop, report)
        except StoppedError:
            return False
        save_arrays(self.path, arrays, **self.identity)
        return True

    def read(self, shapes: Shapes) -> dict[str, np.ndarray]:
        """Reads the file, see `own_arrays`."""
        return own_arrays(self.path, shapes, self.identity)


def identity_of(experiment: Experiment, condition: Condition) -> dict[str, Any]:
    """Returns the notes by which a job recognises its file: experiment and condition."""
    return flat(experiment) | {"condition": str(condition)}


def own_arrays(path: Path, shapes: Shapes, identity: Mapping[str, Any]) -> dict[str, np.ndarray]:
    """Reads the file of a job: the arrays that the job writes, and no others.

    Args:
      path: File to read.
      shapes: The dtype, as safetensors names it, and the shape of each array.
      identity: What says whose file it is, as plain data; files of earlier versions say less.

    Raises:
      FileNotFoundError: there is no such file.
      DamagedFileError: the file is damaged, or another job's.
    """
    arrays, notes = load_arrays(path, functools.partial(check_same_shapes, shapes))
    check_notes(path, notes, {k: value for k, value in identity.items() if k in notes})
    return arrays


def check_notes(path: Path, notes: Mapping[str, Any], identity: Mapping[str, Any]) -> None:
    """Raises DamagedFileError where a file's notes lack a value of its job, or have another.

    Args:
      path: File with the notes.
      notes: Notes of the file.
      identity: What says whose file it is, as plain data.
    """
    for name, wanted in json.loads(json.dumps(identity)).items():  # tuples as lists
        if (held := notes.get(name)) != wanted:
            raise DamagedFileError(
                f"{path} is another's: its {name} is {held!r:.100}, not {wanted!r:.100}"
            )


class MinuteTick:
    """Reports a job's progress every simulated minute, and stops it when asked."""

    def __init__(
        self, job: Job, robots: float, stop: Stop, report: Report, done: float = 0.0
    ) -> None:
        """Starts the count.

        Args:
          job: Job whose progress is reported.
          robots: Number of robots in lockstep, or its mean over several groups.
          stop: Function that returns whether to stop.
          report: Function called with the simulated robot-seconds so far and a message.
          done: Robot-seconds simulated before, by a job that continues.
        """
        self._cost, self._each = job.cost, 60.0 * robots
        self._stop, self._report = stop, report
        self._done = done

    def __call__(self) -> None:
        """Counts a simulated minute.

        Raises:
          StoppedError: the job is asked to stop.
        """
        self._done = min(self._done + self._each, self._cost)
        self._report(self._done, "")
        if self._stop():
            raise StoppedError


def advance(
    cohort: Cohort, until: int, tick: MinuteTick, save: Callable[[], object] = lambda: None
) -> None:
    """Simulates a cohort up to a control step, and counts the minutes.

    Args:
      cohort: Cohort to simulate.
      until: Control step at which it ends.
      tick: Counter of the minutes.
      save: Function that stores the cohort, called once a minute of the wall clock, and when the
        job is asked to stop.

    Raises:
      StoppedError: the job is asked to stop.
    """
    saved = time.monotonic()
    try:
        while cohort.step < until:
            cohort.advance(min(_CHUNK, until - cohort.step))
            tick()
            if time.monotonic() - saved > SAVE_EVERY:
                save()
                saved = time.monotonic()
    except StoppedError:
        save()
        raise


def check_shares(path: Path, shares: np.ndarray) -> None:
    """Raises DamagedFileError if a file's shares are not in [0, 1]; NaN is allowed."""
    if not ((shares >= 0) & (shares <= 1) | np.isnan(shares)).all():
        raise DamagedFileError(f"{path} is damaged (a share is not within [0, 1])")
