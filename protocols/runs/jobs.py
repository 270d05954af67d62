"""Jobs: pieces of work that write files, and that can stop and continue at any moment."""

from __future__ import annotations

import contextlib
import dataclasses
import time
from collections.abc import Callable, Generator, Sequence
from pathlib import Path
from typing import Protocol

from ...tasks.batch import CapacityError
from ...tasks.lives import control_steps
from ..agents.factory import trust
from ..errors import InputError, RunError
from ..progress import JobProgress
from ..storage import remove_files
from .checkpoints import (
    checkpoint_file,
    finished_file,
    restored_cohort,
    save_checkpoint,
    save_lives,
)
from .cohort import Cohort
from .conditions import CohortKey
from .experiment import Experiment

Stop = Callable[[], bool]
Report = Callable[[float, str], None]

_CHUNK = 50  # control steps between two checks of the clock
_REPORT_EVERY = 0.5  # seconds


class Job(Protocol):
    """A piece of work that runs in a process of its own and writes a file.

    Attributes:
      path: File that the job writes, in an existing folder.
      cost: Amount of work: simulated seconds, added up over the job's robots.
    """

    @property
    def path(self) -> Path: ...

    @property
    def cost(self) -> float: ...

    def done(self) -> bool:
        """Returns whether the job's file exists."""
        ...

    def run(self, stop: Stop, report: Report) -> bool:
        """Does the work, or continues where it was stopped; `run_job` calls it.

        Args:
          stop: Function that returns whether the job must stop.
          report: Function that takes the amount of work done so far, in the unit of `cost`, and a
            message; called about twice a second.

        Returns:
          Whether the work is done and its file is written.
        """
        ...


class Executor(Protocol):
    """Runs jobs in processes of this machine or of a cluster."""

    def __call__(self, jobs: Sequence[Job], progress: JobProgress) -> Generator[Job]:
        """Starts jobs in their order, and yields each as soon as it is done.

        Raises:
          Interrupted: Ctrl-C or a termination signal arrived, and the jobs have stopped.
          RunError: a process died, or a file could not be written.
        """
        ...


def run_job(job: Job, stop: Stop, report: Report) -> bool:
    """Runs a job in a process of an executor; see `Job.run`.

    A job that must stop does not begin; a job that is done is not run again.

    Raises:
      RunError: a file could not be written, or the job raised SystemExit.
    """
    if stop():
        return False
    if job.done():  # by a node that was lost before it reported this
        report(job.cost, "")
        return True
    try:
        return job.run(stop, report)
    except OSError as error:
        raise stopped_by(error) from error
    except SystemExit as error:
        raise RunError(f"a process ended itself (status {error.code})") from error


def stopped_by(error: Exception) -> RunError:
    """Returns an error that says in one sentence what stopped a simulation."""
    what = "a process died, perhaps for want of memory"
    if isinstance(error, OSError):
        what = f"a file could not be read or written ({error})"
    return RunError(f"{what}; the same command continues from the last checkpoints")


@dataclasses.dataclass(frozen=True)
class CohortJob:
    """Simulates a cohort from its last checkpoint to the end of its life.

    Attributes:
      directory: Folder of the run, an absolute path.
      experiment: Seed, cohort size, body, brain and other fields that decide the lives.
      key: Condition and number of the cohort.
      save_every: Wall-clock seconds between two checkpoints.
    """

    directory: Path
    experiment: Experiment
    key: CohortKey
    save_every: float

    @property
    def path(self) -> Path:
        return finished_file(self.directory, self.key)

    @property
    def cost(self) -> float:
        steps = sum(self.experiment.life_of(self.key.condition.life).steps())
        return self.experiment.robot_seconds(steps)

    def done(self) -> bool:
        return self.path.exists()

    def run(self, stop: Stop, report: Report) -> bool:
        trust(self.key.condition.proposer)  # checked by `UnfinishedRun.read`
        checkpoint = checkpoint_file(self.directory, self.key)
        cohort = lived(checkpoint, self.experiment, self.key, self.save_every, stop, report)
        if cohort is None:
            return False
        save_lives(self.path, cohort.lives(), self.experiment, self.key)
        remove_files(self.path.parent, checkpoint.name.__eq__)
        report(self.cost, "")
        return True


def lived(
    checkpoint: Path,
    experiment: Experiment,
    key: CohortKey,
    save_every: float,
    stop: Stop,
    report: Report,
) -> Cohort | None:
    """Simulates a cohort, from its checkpoint if there is one; returns None if it must stop.

    Args:
      checkpoint: File of the checkpoint, which is also written before a stop.
      experiment: Seed, cohort size, body, brain and other fields that decide the lives.
      key: Condition and number of the cohort.
      save_every: Wall-clock seconds between two checkpoints.
      stop: See `Job.run`.
      report: See `Job.run`.

    Raises:
      InputError, RunError: an agent failed, or MuJoCo Warp has no room for a robot's contacts.
    """
    cohort, message = restored_cohort(checkpoint, experiment, key)
    report(experiment.robot_seconds(cohort.step), message)
    name = f"{checkpoint.parent.parent.name}/{checkpoint.stem}"  # for messages and errors
    reported = saved = time.monotonic()
    # Steps between two checks of the clock; on a GPU a simulated minute.
    chunk = _CHUNK if experiment.device == "cpu" else control_steps(1)
    while not cohort.finished:
        if stop():
            save_checkpoint(checkpoint, cohort)
            return None
        try:
            cohort.advance(chunk)
        except (InputError, RunError) as error:  # of an agent
            raise type(error)(f"{error}, in {name} at step {cohort.step}") from error
        except CapacityError as error:
            raise RunError(f"{error}, in {name} at step {cohort.step}") from error
        done = experiment.robot_seconds(cohort.step)
        for cause, robots in cohort.newly_stopped().items():
            report(done, f"{cause} in {name}: robots {robots} stopped by step {cohort.step}")
        if (now := time.monotonic()) - reported > _REPORT_EVERY:
            report(done, "")
            reported = now
        if now - saved > save_every:
            save_checkpoint(checkpoint, cohort)
            saved = now
    return cohort


def execute(
    what: str,
    jobs: Sequence[Job],
    executor: Executor,
    finished: Callable[[Job], None] = lambda job: None,
    *,
    watcher: Callable[[], None] = lambda: None,
    quiet: bool = False,
) -> None:
    """Runs jobs, and shows their progress and the remaining time.

    Args:
      what: Description of the jobs, shown next to the progress bar.
      jobs: Jobs to run, the longest first.
      executor: `Local` or `RayCluster`, which runs the jobs in processes.
      finished: Function that is called with each job as soon as it is done.
      watcher: Function that is called several times a second, for example to update a log.
      quiet: Whether to hide the progress.

    Raises:
      Interrupted, RunError: see `Executor`.
    """
    if not jobs:
        return
    robots = [job.experiment.cohort_size for job in jobs if isinstance(job, CohortJob)]
    robots = robots if len(robots) == len(jobs) else []
    costs = [job.cost for job in jobs]
    with (
        JobProgress(what, costs, quiet, robots, watcher) as progress,
        contextlib.closing(executor(jobs, progress)) as running,
    ):
        for job in running:
            finished(job)
