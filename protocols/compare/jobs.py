"""The job of studies: a piece of work whose arrays are stored in one file."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from ..agents.factory import trust
from ..runs.conditions import CohortKey, Condition
from ..runs.experiment import Experiment
from ..runs.jobs import Report, Stop, lived
from ..runs.manifest import check_identity
from ..storage import load_arrays, remove_files, save_arrays

CHECKPOINT = ".checkpoint"  # ending of the file from which work continues
SAVE_EVERY = 60.0  # wall-clock seconds between two checkpoints
Arrays = dict[str, np.ndarray]


class StoppedError(Exception):
    """A job was asked to stop before it was done."""


@dataclasses.dataclass(frozen=True)
class Progress:
    """Argument of a job's work: reports how much is done, and stops the work when asked.

    Attributes:
      checkpoint: File for a state from which the work can continue; removed when the work is done.
    """

    checkpoint: Path
    stop: Stop
    report: Report

    def __call__(self, done: float) -> None:
        """Reports an amount of work done so far, in the unit of `ArrayJob.cost`.

        Raises:
          StoppedError: the job is asked to stop.
        """
        self.report(done, "")
        if self.stop():
            raise StoppedError


@dataclasses.dataclass(frozen=True)
class ArrayJob:
    """Does a piece of work, and stores the arrays that it returns; see `runs.jobs.Job`.

    Attributes:
      path: File to which the arrays are written.
      work: Function that takes a `Progress` and returns the arrays; must be picklable.
      cost: Amount of work: simulated seconds, added up over the robots.
      identity: Plain data that is stored in the file, and by which the job recognises the file.
    """

    path: Path
    work: Callable[[Progress], Arrays]
    cost: float
    identity: Mapping[str, Any]

    def done(self) -> bool:
        return self.path.exists()

    def run(self, stop: Stop, report: Report) -> bool:
        progress = Progress(self.path.with_suffix(CHECKPOINT), stop, report)
        try:
            arrays = self.work(progress)
        except StoppedError:
            return False
        save_arrays(self.path, arrays, **self.identity)
        remove_files(self.path.parent, progress.checkpoint.name.__eq__)
        report(self.cost, "")
        return True

    def read(self) -> Arrays:
        """Reads the arrays that the job has stored.

        Raises:
          FileNotFoundError: the job is not done.
          DamagedFileError: the file is damaged, or another job's.
        """
        arrays, notes = load_arrays(self.path)
        check_identity(self.path, notes, self.identity, "a job")
        return arrays


def simulate_cohort(experiment: Experiment, condition: Condition, progress: Progress) -> Arrays:
    """Simulates a cohort of an agent that the command has named, from a checkpoint if there is one.

    Returns:
      The number of steps with the event in each part of a life, "events" of shape (B, parts), and
      whether each robot stayed stable, "valid" of shape (B,).
    """
    trust(condition.proposer)
    key, stop, report = CohortKey(condition, 0), progress.stop, progress.report
    cohort = lived(progress.checkpoint, experiment, key, SAVE_EVERY, stop, report)
    if cohort is None:
        raise StoppedError
    found = cohort.lives()
    return {"events": found.events.astype(np.int32), "valid": found.valid}
