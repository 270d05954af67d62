"""Studies: jobs with result files, and a page made from these. Handles resuming and locking."""

from __future__ import annotations

import abc
import contextlib
import dataclasses
import functools
import json
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
from matplotlib.figure import Figure

from ...controller.parameters import shown
from ..errors import DamagedFileError, InputError, Interrupted, RunError
from ..experiment.conditions import Condition
from ..experiment.experiment import Experiment, check_same, flat
from ..experiment.manifest import UNREADABLE, experiment_from
from ..experiment.physics_probe import is_physics_of, physics_probe
from ..experiment.plan import MOST_ROBOTS
from ..experiment.provenance import machine
from ..experiment.schedules import control_steps
from ..reporting import style
from ..results.checks import check_same_shapes
from ..simulation.cohort import Cohort
from ..simulation.jobs import Executor, Job, Report, Stop, execute
from ..storage import (
    Shapes,
    check_folder,
    check_own_folder,
    is_draft,
    load_arrays,
    locked,
    read_json,
    remove_drafts,
    remove_files,
    resolved,
    write_json,
    write_text,
)

STUDY_FILE = "study.json"
CHECKPOINT = ".checkpoint"  # ending of a job's file from which it continues
SAVE_EVERY = 60.0  # wall-clock seconds between two checkpoints
_CHUNK = control_steps(1)
_UNFINISHED = "*Unfinished: only what is done so far.*\n\n"

_DEFAULT = {"default": Experiment()}  # whose physics a study without experiments is checked by


@dataclasses.dataclass(frozen=True)
class Page:
    """Results page of a study.

    Attributes:
      markdown: Text with tables, as Markdown.
      figures: Figures of the page by name.
    """

    markdown: str
    figures: Mapping[str, Figure] = dataclasses.field(default_factory=dict)


class Study(abc.ABC):
    """A question, the jobs that answer it, and the page of the answer.

    A subclass is a dataclass whose fields are the options of `musebot study NAME`. The first line
    of its docstring is its description in the list of studies.

    Attributes:
      name: Name of the study on the command line, and of the files of its page and figures.
      shows_finished: Whether `page` shows what is finished while jobs are left. The page is then
        also written when the study is stopped.
    """

    name: ClassVar[str]
    shows_finished: ClassVar[bool] = False

    @abc.abstractmethod
    def experiments(self) -> Mapping[str, Experiment]:
        """Returns the simulated experiments by name; they and their physics identify the study.

        A study without experiments is identified by its `details` and the default robot's physics.

        Raises:
          InputError: an option is invalid, or something that the study needs is missing.
        """

    def details(self) -> Mapping[str, Any]:
        """Returns further values that identify the study, as plain data for JSON."""
        return {}

    def folders(self, out: Path) -> Sequence[Path]:
        """Returns the folders below OUT that hold the study's files."""
        del out
        return []

    def check(self, out: Path) -> None:
        """Raises InputError if the study cannot be continued from its files in OUT."""
        del out

    def stages(self, out: Path) -> Iterator[Sequence[Job]]:
        """Yields groups of jobs; a group is requested only when all earlier jobs are done."""
        del out
        yield from ()

    def finished(self, job: Job) -> None:
        """Receives each job as soon as it is done."""
        del job

    @abc.abstractmethod
    def page(self, out: Path) -> Page:
        """Returns the page made from the finished files; writes no files.

        Raises:
          InputError: a file is missing or damaged.
        """


def page_file(study: Study, out: Path) -> Path:
    """Returns the file of a study's page."""
    return out / f"{study.name}.md"


def conduct(study: Study, out: Path, executor: Executor) -> Page:
    """Runs all jobs of a study that are not done yet, and writes its page and figures.

    Args:
      study: Study to run or to continue.
      out: Folder of the study's files.
      executor: Function that runs the jobs.

    Returns:
      The page that was written.

    Raises:
      InputError: OUT holds other files, another study, or another physics; nothing was done.
      Interrupted, RunError: see `simulation.jobs.Executor`; a repeated call continues the study.
      OSError: a file could not be written.
    """
    out = resolved(out)  # links below it are not followed
    experiments = study.experiments()
    _check(study, experiments, out)
    study.check(out)
    with locked(out):
        made_with = _check(study, experiments, out)  # another command may have come before
        remove_drafts(out)
        # First: a folder that is not empty is continued only if it says which study it holds.
        _write_manifest(study, experiments, out, made_with)
        for folder in study.folders(out):
            folder.mkdir(exist_ok=True)
            remove_drafts(folder)
        try:
            for jobs in study.stages(out):
                left = [job for job in jobs if not job.done()]
                execute(f"{study.name}: {len(left)} jobs", left, executor, study.finished)
        except (Interrupted, RunError):
            if study.shows_finished:
                with contextlib.suppress(InputError, RunError, OSError):  # the first error counts
                    _write_unfinished_page(study, out)
            raise
        for folder in study.folders(out):  # what jobs left that were killed after their end
            remove_files(folder, lambda name: name.endswith(CHECKPOINT))
        return _write_page(study, out)


def _write_unfinished_page(study: Study, out: Path) -> None:
    """Writes a page that says that it is unfinished, unless OUT has a finished one."""
    path = page_file(study, out)
    if not path.exists() or path.read_bytes().startswith(_UNFINISHED.encode()):
        write_text(path, _UNFINISHED + study.page(out).markdown)


def _write_page(study: Study, out: Path) -> Page:
    page = study.page(out)
    write_text(page_file(study, out), page.markdown)
    with style.styled():
        for name, figure in page.figures.items():
            style.save(figure, out, name)
    return page


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
    for name, wanted in _plain(identity).items():
        if (held := notes.get(name)) != wanted:
            raise DamagedFileError(
                f"{path} is another's: its {name} is {held!r:.100}, not {wanted!r:.100}"
            )


class StoppedError(Exception):
    """A job was asked to stop before it was done."""


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


def check_positive(most: int = MOST_ROBOTS, /, **numbers: int) -> None:
    """Raises InputError where an option that counts something is less than 1, or too large."""
    for name, number in numbers.items():
        if number < 1:
            raise InputError(f"{name} must be at least 1, got {number}")
        if number > most:
            raise InputError(f"{name} must be at most {most}, got {shown(number)}")


def _check(study: Study, experiments: Mapping[str, Experiment], out: Path) -> list[Any]:
    """Checks that OUT can hold a study; returns the versions and machines that made it."""
    check_folder(out)
    for folder in study.folders(out):
        check_own_folder(folder)
    path = out / STUDY_FILE
    if not path.is_file():
        if out.is_dir() and not all(map(is_draft, out.iterdir())):
            raise InputError(f"{out} is not empty and holds no study of musebot's")
        return []
    try:
        held = read_json(path)
        name, details, made_with = held["study"], held["details"], [*held["made_with"]]
        known = {n: experiment_from(fields) for n, fields in held["experiments"].items()}
        probes = {n: tuple(map(float, held["physics"][n])) for n in known or _DEFAULT}
        if not isinstance(details, dict):
            raise TypeError("its details are no object")
    except UNREADABLE as error:
        raise DamagedFileError(f"{path} is no study of musebot's ({error!r:.200})") from error
    if name != study.name:
        raise InputError(f"{out} holds the study {name}, not {study.name}")
    if known.keys() - experiments.keys():  # more are added, as by a later version's stages
        names = [", ".join(one) for one in (known, experiments)]
        raise InputError(f"{out} holds a study of {names[0]}, not of {names[1]}")
    for one, stored in known.items():
        check_same(f"{out} holds a study of {one}", stored, experiments[one])
    for detail, wanted in _plain(study.details()).items():
        if details.get(detail) != wanted:
            raise InputError(
                f"{out} holds a study with {detail} {details.get(detail)!r:.100}, "
                f"not {wanted!r:.100}"
            )
    for one, probe in probes.items():
        if not is_physics_of(probe, (experiments or _DEFAULT)[one]):
            raise InputError(f"{out} was simulated in another physics than this version's")
    return made_with


def _write_manifest(
    study: Study, experiments: Mapping[str, Experiment], out: Path, made_with: list[Any]
) -> None:
    probed = (experiments or _DEFAULT).items()
    content = {
        "study": study.name,
        "experiments": {n: dataclasses.asdict(one) for n, one in experiments.items()},
        "physics": {n: physics_probe(one.body, one.kinematics) for n, one in probed},
        "details": study.details(),
        "made_with": [*(one for one in made_with if one != machine()), machine()],
    }
    write_json(out / STUDY_FILE, content)


def _plain(details: Mapping[str, Any]) -> dict[str, Any]:
    """Returns details as plain data for JSON, for example with lists for tuples."""
    return json.loads(json.dumps(details))
