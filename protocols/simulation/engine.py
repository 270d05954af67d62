"""Many lives: cohorts, checkpointed, and taken up where they stopped.

What a cohort does, `live`, is the same on this machine's cores (`protocols/processes.py`) and on a
Ray cluster's (`protocols/cluster.py`).
"""

from __future__ import annotations

import contextlib
import dataclasses
import fcntl
import os
import queue
import sys
import time
from collections.abc import Callable, Generator, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, Protocol

from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

from ...tasks import CONTROL_TIMESTEP
from ..errors import DamagedFileError, InputError
from ..experiment.experiment import (
    CohortKey,
    Experiment,
    Plan,
    check_physics,
    load_plan,
    same_physics,
    save_plan,
)
from ..results.results import Results, collect, load, merge, save
from ..storage import check_folder, is_draft, load_arrays, remove_drafts, save_arrays
from .cohort import Cohort, Lives

PLAN = "experiment.json"
CHECKPOINTS = "checkpoints"
_CHUNK = 50  # control steps between two looks at the clock


@dataclasses.dataclass(frozen=True)
class Job:
    """A cohort that is still to be lived, and how.

    Attributes:
      directory: of its run, an absolute path.
      experiment: what decides its lives.
      key: which cohort of the run.
      save_every: seconds between two of its checkpoints.
    """

    directory: Path
    experiment: Experiment
    key: CohortKey
    save_every: float

    def __str__(self) -> str:
        return f"{self.directory.name}/{self.key}"

    @property
    def steps(self) -> int:
        """Control steps of the whole life."""
        return sum(self.experiment.schedule(self.key.task).steps())


class Workforce(Protocol):
    """Whatever lives cohorts: this machine's processes, or a cluster's."""

    def __call__(self, jobs: Sequence[Job], display: Display) -> Generator[Job]:
        """Begins cohorts in their order, and yields each as soon as it has its finished file.

        Raises:
          Interrupted: by Ctrl-C or SIGTERM, after checkpoints were written.
          RunError: it could not go on.
        """
        ...


def run(
    directory: Path,
    plan: Plan,
    workforce: Workforce,
    *,
    save_every: float = 60.0,
    quiet: bool = False,
) -> Results:
    """Lives all the plan's lives that are not finished yet, and keeps them in a directory.

    Args:
      directory: new, empty, or of the same experiment (`open_directory` checks that).
      plan: which lives.
      workforce: who lives them: `processes.Processes(n)`, or `cluster.Ray(address)`.
      save_every: seconds between two checkpoints of a cohort.
      quiet: shows no progress.

    Returns:
      All lives of the directory.

    Raises:
      InputError: the directory is another run's, or its experiment or physics is another.
      Interrupted: by Ctrl-C or SIGTERM, after checkpoints were written.
      RunError: a process died, or a cohort's file could not be written.
      OSError: the results could not be written; the cohorts' files are kept.
    """
    return run_all({directory: plan}, workforce, save_every=save_every, quiet=quiet)[directory]


def run_all(
    plans: Mapping[Path, Plan],
    workforce: Workforce,
    *,
    save_every: float = 60.0,
    quiet: bool = False,
) -> dict[Path, Results]:
    """Lives several runs together, so that one of few cohorts leaves no core idle.

    A run's lives are in its directory as soon as its own last cohort has lived.

    Args:
      plans: which lives, by the directory of the run.
      workforce: who lives them; see `run`, which says also what is raised.
      save_every: seconds between two checkpoints of a cohort.
      quiet: shows no progress.

    Returns:
      All lives of each directory.
    """
    with contextlib.ExitStack() as stack:
        for directory in plans:
            stack.enter_context(locked(directory))
        # What cannot be gone on with is refused before anything is changed.
        runs = [_Run.read(directory, plan) for directory, plan in plans.items()]
        damage = [sentence for run in runs for sentence in run.begin()]
        jobs = [
            Job(run.directory, run.plan.experiment, key, save_every)
            for run in runs
            for key in run.left
        ]
        if jobs:
            where = {run.directory: run for run in runs}
            display = stack.enter_context(Display(jobs, quiet))
            for sentence in damage:
                display.tell(sentence)
            for job in stack.enter_context(contextlib.closing(workforce(jobs, display))):
                where[job.directory].has_lived(job.key)
        return {directory: run.done for directory, run in zip(plans, runs, strict=True)}


@dataclasses.dataclass
class _Run:
    """A run that is gone on with.

    Attributes:
      directory: an absolute path.
      plan: which lives it will have.
      done: what it has.
      left: cohorts that are not finished.
      lived: cohorts that are finished, and wait for the others.
    """

    directory: Path
    plan: Plan
    done: Results
    left: list[CohortKey]
    lived: dict[CohortKey, Lives]

    @classmethod
    def read(cls, directory: Path, plan: Plan) -> _Run:
        """What a directory holds beside what the plan asks for; changes nothing."""
        directory = directory.resolve()
        if (directory / PLAN).exists():
            plan = plan.merged_with(load_plan(directory / PLAN))
        done = load(directory)
        known = {(r.task, r.proposer, r.cohort) for r in done.robots}
        left = [k for k in plan.cohorts() if (k.task, k.proposer, k.index) not in known]
        if left and (directory / PLAN).exists():
            check_physics(directory / PLAN)
        return cls(directory, plan, done, left, {})

    def begin(self) -> list[str]:
        """Writes the plan, and reads what an earlier call has finished, or sets it aside.

        Returns:
          What is to be said of files that had to be set aside.
        """
        checkpoints = self.directory / CHECKPOINTS
        for folder in (self.directory, checkpoints):
            remove_drafts(folder)
        if not self.left:
            self._clear()
            return []
        begun = bool(self.done.robots) or checkpoints.exists()
        save_plan(self.directory / PLAN, self.plan, begun)
        damage = []
        for key in [*self.left]:
            path = finished_file(self.directory, key)
            try:
                lives = read_lives(path)
            except FileNotFoundError:
                continue
            except DamagedFileError as error:
                damage.append(_set_aside(path, key, error))
            else:
                self._add(key, lives)
        return damage

    def has_lived(self, key: CohortKey) -> None:
        """Reads a cohort's finished file; after the last one all lives are put together."""
        self._add(key, read_lives(finished_file(self.directory, key)))

    def _add(self, key: CohortKey, lives: Lives) -> None:
        self.lived[key] = lives
        self.left.remove(key)
        if not self.left:
            self.done = merge(self.done, collect(self.plan.experiment, self.lived.items()))
            save(self.directory, self.done)
            self.lived.clear()
            self._clear()

    def _clear(self) -> None:
        for file in (self.directory / CHECKPOINTS).glob("*"):
            if file.suffix != ".damaged":
                file.unlink()
        with contextlib.suppress(OSError):
            (self.directory / CHECKPOINTS).rmdir()


def open_directory(directory: Path) -> Plan | None:
    """Looks whether a directory can hold a run; returns the plan of the one it holds.

    Raises:
      InputError: it is a file, cannot be written, or holds something else.
    """
    try:
        check_folder(directory)
        if (directory / PLAN).exists():
            return load_plan(directory / PLAN)
        if directory.exists() and not all(map(is_draft, directory.iterdir())):
            raise InputError(f"{directory} is not empty and holds no experiment of musebot's")
    except OSError as error:
        raise InputError(f"{directory} cannot be used ({error.strerror})") from error
    return None


def read_run(directory: Path, *, enact: bool = False) -> tuple[Experiment, Results]:
    """Reads a run's experiment and its finished lives.

    Args:
      directory: of the run.
      enact: whether its brains are to be put back; says on stderr where the physics is another.

    Raises:
      InputError: it holds none, or what it holds is damaged.
    """
    if not (directory / PLAN).is_file():
        raise InputError(f"{directory} holds no experiment of musebot's")
    experiment, lives = load_plan(directory / PLAN).experiment, load(directory)
    if not lives.robots:
        raise InputError(
            f"{directory} holds no finished lives yet; `musebot run {directory}` goes on with them"
        )
    if enact and not same_physics(directory / PLAN):
        print(
            f"musebot: {directory} was lived in another physics than this version's, in which its "
            "brains are now put back",
            file=sys.stderr,
        )
    return experiment, lives


@contextlib.contextmanager
def locked(directory: Path) -> Iterator[None]:
    """Makes a folder, and keeps other processes of musebot's from working in it.

    Raises:
      InputError: another one does.
    """
    directory.mkdir(parents=True, exist_ok=True)
    handle = os.open(directory, os.O_RDONLY)
    try:
        try:
            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError as error:
            raise InputError(f"another musebot is running in {directory}") from error
        yield
    finally:
        os.close(handle)


def checkpoint_file(directory: Path, key: CohortKey) -> Path:
    """Where a cohort's last checkpoint is kept while it lives."""
    return directory / CHECKPOINTS / f"{key}.safetensors"


def finished_file(directory: Path, key: CohortKey) -> Path:
    """Where a finished cohort waits for the others."""
    return directory / CHECKPOINTS / f"{key}.finished.safetensors"


class Display:
    """Progress with time left, and what the cohorts have to say."""

    def __init__(self, jobs: Sequence[Job], quiet: bool) -> None:
        self._robots = [job.experiment.cohort_size for job in jobs]
        self._steps: dict[int, int] = {}
        self._first: dict[int, int] = {}  # what earlier runs lived is not this one's speed
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
        total = self._lived({number: job.steps for number, job in enumerate(jobs)})
        self._bar = self._progress.add_task(
            f"{len(jobs)} cohorts, {total / 3600:,.0f} robot-hours", total=total, speed=""
        )
        self._began = time.monotonic()

    def __enter__(self) -> Display:
        self._progress.start()
        return self

    def __exit__(self, *exception: object) -> None:
        self._progress.stop()

    def tell(self, sentence: str) -> None:
        """Says something, above the progress."""
        self._progress.console.print(f"[yellow]{sentence}[/yellow]")

    def show(self, reports: Any) -> None:
        """Shows what has come into a queue of (number of a job, its control step, message)."""
        with contextlib.suppress(queue.Empty):
            while True:
                number, steps, message = reports.get_nowait()
                if message:
                    self.tell(message)
                self._steps[number] = steps
                self._first.setdefault(number, steps)
        done = self._lived(self._steps)
        new = done - self._lived(self._first)
        speed = f"{new / (time.monotonic() - self._began):,.0f} x real time" if new else ""
        self._progress.update(self._bar, completed=done, speed=speed)

    def _lived(self, steps: Mapping[int, int]) -> float:
        """Simulated seconds of all robots together, from the control steps of each job."""
        robot_steps = sum(self._robots[number] * count for number, count in steps.items())
        return robot_steps * CONTROL_TIMESTEP


def live(job: Job, stop: Callable[[], bool], report: Callable[[int, str], None]) -> bool:
    """Lives a cohort from its last checkpoint to its end, or until it is asked to stop.

    Args:
      job: which cohort.
      stop: whether to stop.
      report: told the control step, and what there is to say, about twice a second.

    Returns:
      Whether it came to its end, and its finished file is written.

    Raises:
      OSError: a file cannot be written.
    """
    if stop():
        return False
    directory, key = job.directory, job.key
    if finished_file(directory, key).exists():  # by a node that was lost before it could say so
        report(job.steps, "")
        return True
    cohort, message = _restored(job)
    report(cohort.step, message)
    saved = reported = time.monotonic()
    broken = int((~cohort.batch.valid).sum())
    while not cohort.finished:
        if stop():
            _save_checkpoint(directory, key, cohort)
            return False
        cohort.advance(_CHUNK)
        message = ""
        if (count := int((~cohort.batch.valid).sum())) > broken:
            robots = (~cohort.batch.valid).nonzero()[0].tolist()
            message = f"unstable simulation in {job}: robots {robots} stopped by step {cohort.step}"
            broken = count
        now = time.monotonic()
        if message or now - reported > 0.5:
            report(cohort.step, message)
            reported = now
        if now - saved > job.save_every:
            _save_checkpoint(directory, key, cohort)
            saved = now
    _save_lives(finished_file(directory, key), cohort.lives())
    checkpoint_file(directory, key).unlink(missing_ok=True)
    report(cohort.step, "")
    return True


def _save_checkpoint(directory: Path, key: CohortKey, cohort: Cohort) -> None:
    arrays, notes = cohort.checkpoint()
    save_arrays(checkpoint_file(directory, key), arrays, cohort=str(key), **notes)


def _restored(job: Job) -> tuple[Cohort, str]:
    """The cohort as its checkpoint has it, or newborn; and what is to be said of that."""
    path = checkpoint_file(job.directory, job.key)
    cohort = Cohort(job.experiment, job.key)
    try:
        cohort.restore(*load_arrays(path))
    except FileNotFoundError:
        return cohort, ""
    except (DamagedFileError, ValueError, KeyError) as error:
        return Cohort(job.experiment, job.key), _set_aside(path, job.key, error)
    return cohort, ""


def _set_aside(path: Path, key: CohortKey, error: Exception) -> str:
    """Keeps a damaged file out of the way; returns what is to be said of that."""
    path.replace(path.with_suffix(".damaged"))
    return f"{error}; set aside, cohort {key} starts anew"


def _save_lives(path: Path, lives: Lives) -> None:
    arrays = {"events": lives.events, "minutes": lives.minutes, "valid": lives.valid}
    for when, networks in (("before", lives.before), ("after", lives.after)):
        arrays |= {f"{when}/{name}": array for name, array in networks.items()}
    save_arrays(path, arrays)


def read_lives(path: Path) -> Lives:
    """Reads a finished cohort.

    Raises:
      FileNotFoundError: there is none.
      DamagedFileError: it is damaged.
    """
    arrays, _ = load_arrays(path)
    return Lives(
        arrays["events"],
        arrays["minutes"],
        arrays["valid"],
        *(
            {k.partition("/")[2]: v for k, v in arrays.items() if k.startswith(f"{when}/")}
            for when in ("before", "after")
        ),
    )
