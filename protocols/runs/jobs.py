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
    restored_cohorts,
    save_checkpoint,
    save_lives,
)
from .cohort import Cohort, advance_together
from .conditions import CohortKey
from .device import HOST
from .experiment import Experiment

Stop = Callable[[], bool]
Report = Callable[[float, str], None]

DIED = "a process died, perhaps for want of memory"
_CHUNK = 50  # control steps between two checks of the clock
_REPORT_EVERY = 0.5  # seconds


class Job(Protocol):
    """A piece of work that runs in a process of its own and writes a file, or a few.

    Attributes:
      path: File that the job writes last, in an existing folder.
      cost: Amount of work: simulated seconds, added up over the job's robots.
    """

    @property
    def path(self) -> Path: ...

    @property
    def cost(self) -> float: ...

    def done(self) -> bool:
        """Returns whether the job's files exist."""
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
    what = f"a file could not be read or written ({error})" if isinstance(error, OSError) else DIED
    return RunError(f"{what}; the same command continues from the last checkpoints")


@dataclasses.dataclass(frozen=True)
class CohortJob:
    """Simulates a cohort, or several, from the last checkpoint to the end of their lives.

    Attributes:
      directory: Folder of the run, an absolute path.
      experiment: Seed, cohort size, body, brain and other fields that decide the lives.
      keys: Condition and number of each cohort; several must be of one task, and share one batch.
      save_every: Wall-clock seconds between two checkpoints.
    """

    directory: Path
    experiment: Experiment
    keys: tuple[CohortKey, ...]
    save_every: float

    def __str__(self) -> str:
        return " with ".join(map(self._name, self.keys))

    @property
    def path(self) -> Path:
        return finished_file(self.directory, self.keys[0])

    @property
    def cost(self) -> float:
        task = self.keys[0].condition.task
        steps = len(self.keys) * sum(self.experiment.life_of(task).steps())
        return self.experiment.robot_seconds(steps)

    def done(self) -> bool:
        return all(finished_file(self.directory, key).exists() for key in self.keys)

    def run(self, stop: Stop, report: Report) -> bool:
        for key in self.keys:
            trust(key.condition.proposer)  # checked by `UnfinishedRun.read`
        cohorts, message = restored_cohorts(self.directory, self.experiment, self.keys)
        report(self._seconds(cohorts), message)
        reported = saved = time.monotonic()
        while not all(cohort.finished for cohort in cohorts):
            if stop():
                self._save(cohorts)
                return False
            self._advance(cohorts)
            for cohort in cohorts:
                for cause, robots in cohort.newly_stopped().items():
                    where = f"{self._name(cohort.key)}: robots {robots}"
                    sentence = f"{cause} in {where} stopped by step {cohort.step}"
                    report(self._seconds(cohorts), sentence)
            if (now := time.monotonic()) - reported > _REPORT_EVERY:
                report(self._seconds(cohorts), "")
                reported = now
            if now - saved > self.save_every:
                self._save(cohorts)
                saved = now
        self._finish(cohorts)
        report(self._seconds(cohorts), "")
        return True

    def _advance(self, cohorts: Sequence[Cohort]) -> None:
        """Simulates up to the next check of the clock: `_CHUNK` steps, on a GPU a simulated minute.

        Raises:
          InputError, RunError: an agent failed, or MuJoCo Warp has no room for a robot's contacts.
        """
        try:
            on_host = self.experiment.device == HOST
            advance_together(cohorts, _CHUNK if on_host else control_steps(1))
        except (InputError, RunError) as error:  # of an agent
            step = min(cohort.step for cohort in cohorts)
            raise type(error)(f"{error}, in {self} at step {step}") from error
        except CapacityError as error:
            number, robot = divmod(error.robots[0], self.experiment.cohort_size)
            where = self._name(self.keys[number])
            raise RunError(f"{error}; in {where} this is robot {robot}") from error

    def _save(self, cohorts: Sequence[Cohort]) -> None:
        for cohort in cohorts:
            save_checkpoint(checkpoint_file(self.directory, cohort.key), cohort)

    def _finish(self, cohorts: Sequence[Cohort]) -> None:
        """Writes the results, with the file `path` as the last one; removes the checkpoints."""
        for cohort in reversed(cohorts):
            path = finished_file(self.directory, cohort.key)
            save_lives(path, cohort.lives(), self.experiment, cohort.key)
        checkpoints = {checkpoint_file(self.directory, key).name for key in self.keys}
        remove_files(self.path.parent, checkpoints.__contains__)

    def _name(self, key: CohortKey) -> str:
        return f"{self.directory.name}/{key}"

    def _seconds(self, cohorts: Sequence[Cohort]) -> float:
        return self.experiment.robot_seconds(sum(cohort.step for cohort in cohorts))


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
    robots = [len(j.keys) * j.experiment.cohort_size for j in jobs if isinstance(j, CohortJob)]
    robots = robots if len(robots) == len(jobs) else []
    costs = [job.cost for job in jobs]
    with (
        JobProgress(what, costs, quiet, robots, watcher) as progress,
        contextlib.closing(executor(jobs, progress)) as running,
    ):
        for job in running:
            finished(job)
