"""Jobs: pieces of work that write one file each, and can stop and continue at any moment."""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Callable, Generator, Sequence
from pathlib import Path
from typing import Protocol

from ...tasks.arena import CONTROL_TIMESTEP
from ..agents.trust import trust
from ..errors import InputError, RunError
from ..experiment.conditions import CohortKey
from ..experiment.experiment import Experiment
from ..experiment.schedules import control_steps
from ..storage import remove_files
from ..terminal import JobProgress
from .checkpoints import (
    checkpoint_file,
    finished_file,
    restored_cohort,
    save_checkpoint,
    save_lives,
)

Stop = Callable[[], bool]
Report = Callable[[float, str], None]

_CHUNK = 50  # control steps between two looks at the clock


class Job(Protocol):
    """A piece of work that runs in a process of its own and writes exactly one file."""

    @property
    def path(self) -> Path:
        """The file that the job writes, in an existing folder."""
        ...

    @property
    def cost(self) -> float:
        """Amount of work: simulated seconds, added up over the job's robots."""
        ...

    def done(self) -> bool:
        """Returns whether the job's file exists."""
        ...

    def run(self, stop: Stop, report: Report) -> bool:
        """Does the work, or continues where it was stopped.

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


@dataclasses.dataclass(frozen=True)
class CohortJob:
    """Simulates a cohort from its last checkpoint to the end of its life.

    Attributes:
      directory: Folder of the run, an absolute path.
      experiment: Experiment that decides the robots' lives.
      key: Condition and number of the cohort.
      save_every: Wall-clock seconds between two checkpoints.
    """

    directory: Path
    experiment: Experiment
    key: CohortKey
    save_every: float

    def __str__(self) -> str:
        return f"{self.directory.name}/{self.key}"

    @property
    def path(self) -> Path:
        """See `Job.path`."""
        return finished_file(self.directory, self.key)

    @property
    def cost(self) -> float:
        """See `Job.cost`."""
        return self._seconds(sum(self.experiment.schedule(self.key.condition.task).steps()))

    def done(self) -> bool:
        """See `Job.done`."""
        return self.path.exists()

    def run(self, stop: Stop, report: Report) -> bool:
        """See `Job.run`; also reports robots whose simulation becomes unstable."""
        if stop():
            return False
        if self.done():  # by a node that was lost before it could report
            report(self.cost, "")
            return True
        trust(self.key.condition.proposer)  # checked by `UnfinishedRun.read`
        cohort, message = restored_cohort(self.directory, self.experiment, self.key)
        report(self._seconds(cohort.step), message)
        saved = reported = time.monotonic()
        broken = int((~cohort.valid).sum())
        # Robots on tensors are looked at once a simulated minute.
        chunk = control_steps(1) if self.experiment.on_tensors else _CHUNK
        while not cohort.finished:
            if stop():
                save_checkpoint(self.directory, self.key, cohort)
                return False
            try:
                cohort.advance(chunk)
            except (InputError, RunError) as error:  # of an agent
                raise type(error)(f"{error}, in {self} at step {cohort.step}") from error
            message = ""
            if (count := int((~cohort.valid).sum())) > broken:
                robots = (~cohort.valid).nonzero()[0].tolist()
                message = (
                    f"unstable simulation in {self}: robots {robots} stopped by step {cohort.step}"
                )
                broken = count
            now = time.monotonic()
            if message or now - reported > 0.5:
                report(self._seconds(cohort.step), message)
                reported = now
            if now - saved > self.save_every:
                save_checkpoint(self.directory, self.key, cohort)
                saved = now
        save_lives(self.path, cohort.lives(), self.experiment, self.key)
        checkpoint = checkpoint_file(self.directory, self.key)
        remove_files(checkpoint.parent, checkpoint.name.__eq__)
        report(self._seconds(cohort.step), "")
        return True

    def _seconds(self, steps: int) -> float:
        return steps * self.experiment.cohort_size * CONTROL_TIMESTEP


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
    robots = [job.experiment.cohort_size for job in jobs if isinstance(job, CohortJob)]
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
