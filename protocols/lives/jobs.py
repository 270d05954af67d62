"""Jobs: pieces of work that write files, and can stop and continue at any moment."""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Callable, Generator, Sequence
from pathlib import Path
from typing import Protocol

from ...tasks.batch import CapacityError
from ..agents.base import sound
from ..agents.trust import trust
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
from .schedules import control_steps

Stop = Callable[[], bool]
Report = Callable[[float, str], None]

_CHUNK = 50  # control steps between two looks at the clock


class Job(Protocol):
    """A piece of work that runs in a process of its own and writes a file, or a few."""

    @property
    def path(self) -> Path:
        """The file that the job writes last, in an existing folder."""
        ...

    @property
    def cost(self) -> float:
        """Amount of work: simulated seconds, added up over the job's robots."""
        ...

    def done(self) -> bool:
        """Returns whether the job's files exist."""
        ...

    def run(self, stop: Stop, report: Report) -> bool:
        """Does the work, or continues where it was stopped; `run_job` calls it.

        Args:
          stop: Function that returns whether the job must stop.
          report: Function that is called about twice a second with the amount of work done so far,
            in the unit of `cost`, and a message.

        Returns:
          Whether the work is done and its file is written.

        Raises:
          OSError: a file cannot be written.
        """
        ...


class Executor(Protocol):
    """Runs jobs in processes of this machine or of a cluster."""

    def __call__(self, jobs: Sequence[Job], progress: JobProgress) -> Generator[Job]:
        """Starts jobs in their order, and yields each as soon as it is done.

        Raises:
          Interrupted: by Ctrl-C or SIGTERM, after the jobs have stopped.
          RunError: a process died, or a file could not be written.
        """
        ...


def run_job(job: Job, stop: Stop, report: Report) -> bool:
    """Runs a job, as each process of an executor does; see `Job.run`.

    A job that must stop does not begin, and one that is done is not run again.
    """
    if stop():
        return False
    if job.done():  # by a node that was lost before it could report
        report(job.cost, "")
        return True
    return job.run(stop, report)


@dataclasses.dataclass(frozen=True)
class CohortJob:
    """Simulates a cohort, or several, from the last checkpoint to the end of their lives.

    Attributes:
      directory: Folder of the run, an absolute path.
      experiment: Experiment that decides the robots' lives.
      keys: Condition and number of each cohort: one, or several of a task whose robots share the
        physics.
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
        """See `Job.path`."""
        return finished_file(self.directory, self.keys[0])

    @property
    def cost(self) -> float:
        """See `Job.cost`."""
        task = self.keys[0].condition.task
        steps = len(self.keys) * sum(self.experiment.schedule(task).steps())
        return self.experiment.robot_seconds(steps)

    def done(self) -> bool:
        """See `Job.done`."""
        return all(finished_file(self.directory, key).exists() for key in self.keys)

    def run(self, stop: Stop, report: Report) -> bool:
        """See `Job.run`; also reports robots whose simulation becomes unstable."""
        for key in self.keys:
            trust(key.condition.proposer)  # checked by `UnfinishedRun.read`
        cohorts, message = restored_cohorts(self.directory, self.experiment, self.keys)
        report(self._seconds(cohorts), message)
        saved = reported = time.monotonic()
        broken: list[list[int]] = [[] for _ in cohorts]
        # On a GPU robots are looked at once a simulated minute.
        chunk = _CHUNK if self.experiment.device == HOST else control_steps(1)
        while not all(cohort.finished for cohort in cohorts):
            if stop():
                self._save(cohorts)
                return False
            try:
                advance_together(cohorts, chunk)
            except (InputError, RunError) as error:  # of an agent
                step = min(cohort.step for cohort in cohorts)
                raise type(error)(f"{error}, in {self} at step {step}") from error
            except CapacityError as error:
                number, robot = divmod(error.robots[0], self.experiment.cohort_size)
                raise RunError(
                    f"{error}; in {self._name(self.keys[number])} this is robot {robot}"
                ) from error
            now = time.monotonic()
            for number, cohort in enumerate(cohorts):
                robots = (~cohort.valid).nonzero()[0].tolist()
                if len(robots) > len(broken[number]):
                    new = sorted({*robots}.difference(broken[number]))
                    broken[number] = robots
                    where, step = self._name(cohort.key), cohort.step
                    for what, stopped in _causes(cohort, new):
                        message = f"{what} in {where}: robots {stopped} stopped by step {step}"
                        report(self._seconds(cohorts), message)
                    reported = now
            if now - reported > 0.5:
                report(self._seconds(cohorts), "")
                reported = now
            if now - saved > self.save_every:
                self._save(cohorts)
                saved = now
        for cohort in reversed(cohorts):
            path = finished_file(self.directory, cohort.key)
            save_lives(path, cohort.lives(), self.experiment, cohort.key)
        ours = {checkpoint_file(self.directory, key) for key in self.keys}
        remove_files(self.path.parent, {path.name for path in ours}.__contains__)
        report(self._seconds(cohorts), "")
        return True

    def _save(self, cohorts: Sequence[Cohort]) -> None:
        for cohort in cohorts:
            save_checkpoint(checkpoint_file(self.directory, cohort.key), cohort)

    def _name(self, key: CohortKey) -> str:
        return f"{self.directory.name}/{key}"

    def _seconds(self, cohorts: Sequence[Cohort]) -> float:
        steps = sum(cohort.step for cohort in cohorts)
        return self.experiment.robot_seconds(steps)


def _causes(cohort: Cohort, stopped: Sequence[int]) -> list[tuple[str, list[int]]]:
    """Returns what stopped some robots of a cohort, and which of them."""
    # An action that is not finite stops a robot before its weights are looked at.
    unsound = cohort.unsound | ~sound(cohort.agent.weights(), cohort.experiment.cohort_size)
    found = {
        "unstable simulation": [robot for robot in stopped if not unsound[robot]],
        "weights that are not finite": [robot for robot in stopped if unsound[robot]],
    }
    return [(what, robots) for what, robots in found.items() if robots]


def execute(
    what: str,
    jobs: Sequence[Job],
    executor: Executor,
    finished: Callable[[Job], None] = lambda job: None,
    *,
    messages: Sequence[str] = (),
    quiet: bool = False,
) -> None:
    """Runs jobs, and shows their progress and the remaining time.

    Args:
      what: Description of the jobs, shown next to the progress bar.
      jobs: Jobs to run, the longest first.
      executor: Executor that runs the jobs.
      finished: Function that is called with each job as soon as the job is done.
      messages: Sentences to show before the jobs start.
      quiet: Whether to show nothing.

    Raises:
      Interrupted, RunError: see `Executor`.
    """
    if not jobs:
        return
    robots = [
        job.experiment.cohort_size * len(job.keys) for job in jobs if isinstance(job, CohortJob)
    ]
    robots = robots if len(robots) == len(jobs) else []
    with JobProgress(what, [job.cost for job in jobs], quiet, robots) as progress:
        for sentence in messages:
            progress.tell(sentence)
        running = executor(jobs, progress)
        try:
            for job in running:
                finished(job)
        finally:
            running.close()
