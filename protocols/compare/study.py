"""Conducts studies: jobs that write files, and a page made from these; continues stopped ones.

A study's folder OUT holds study.json (its name and options), the files of its jobs, the runs that
it simulates, and its page.
"""

from __future__ import annotations

import abc
import contextlib
import dataclasses
import json
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar

from ...fields import check
from ..errors import DamagedFileError, InputError
from ..pages import style
from ..runs.experiment import Experiment
from ..runs.jobs import Executor, Job, execute
from ..runs.manifest import UNREADABLE, check_identity, made_with
from ..runs.physics_probe import is_physics_of, physics_probe
from ..runs.plan import Plan
from ..runs.run_files import planned
from ..runs.simulation import UnfinishedRun
from ..storage import (
    check_folder,
    check_own_folder,
    is_draft,
    locked,
    read_json,
    remove_drafts,
    remove_files,
    resolved,
    write_json,
    write_text,
)
from ..terminal import notice
from .jobs import CHECKPOINT, SAVE_EVERY

if TYPE_CHECKING:
    from matplotlib.figure import Figure

STUDY_FILE = "study.json"
RunJobs = Callable[..., None]
"""Runs the jobs that are not done; calls its second argument, if any, with each finished job."""


@dataclasses.dataclass(frozen=True)
class Page:
    """Results page of a study.

    Attributes:
      figures: Figures by the name of their files, without the suffix.
    """

    markdown: str
    figures: Mapping[str, Figure] = dataclasses.field(default_factory=dict)


class Study(abc.ABC):
    """A question, the work that answers it, and the page of the answer.

    A subclass is a dataclass whose fields are the options, with their ranges (module `fields`).

    Attributes:
      name: Name of the study and of its page, NAME.md.
      folders: Names of the folders below OUT that hold the files of its jobs.
    """

    name: ClassVar[str]
    folders: ClassVar[tuple[str, ...]] = ()

    def __post_init__(self) -> None:
        """Raises InputError where an option is out of its range."""
        try:
            check(self)
        except ValueError as error:
            raise InputError(str(error)) from error

    @abc.abstractmethod
    def identity(self) -> Mapping[str, Any]:
        """Returns what must not change when the study is continued, as plain data for JSON.

        Raises:
          InputError: an option is invalid, or something that the study needs is missing.
        """

    def experiment(self) -> Experiment:
        """Returns an experiment with the physics of the study's jobs."""
        return Experiment()

    def plans(self) -> Mapping[str, Plan]:
        """Returns the plans of the runs that the study simulates, by the names of their folders.

        Raises:
          InputError: an option is invalid.
        """
        return {}

    @abc.abstractmethod
    def work(self, out: Path, run_jobs: RunJobs) -> None:
        """Does all remaining work; the study's own folders in OUT exist already."""

    @abc.abstractmethod
    def page(self, out: Path) -> Page:
        """Returns the page made from the finished files; writes no files.

        Raises:
          InputError: a file is missing or damaged.
        """


def conduct(study: Study, out: Path, executor: Executor) -> Page:
    """Does the remaining work of a study, and writes its page and figures to the folder OUT.

    Raises:
      InputError: OUT has other files, another study or run, or results of other physics, or a run's
        robots cannot be simulated; nothing was done. Or the file of a finished job is damaged; then
        the other jobs are done.
      Interrupted, RunError: see `runs.jobs.Executor`; a repeated call continues the study.
      OSError: a file could not be written.
    """
    out = resolved(out)  # links below it are not followed
    identity, plans = json.loads(json.dumps(study.identity())), study.plans()
    _check(study, identity, out)
    for name, plan in plans.items():  # before anything is written
        planned(out / name)  # refuses what is no run
        UnfinishedRun.read(out / name, plan).check(getattr(executor, "processes", 1))

    def run_jobs(jobs: Sequence[Job], finished: Callable[[Job], None] = lambda job: None) -> None:
        left = [job for job in jobs if not job.done()]
        execute(f"{study.name}: {len(left)} jobs", left, executor, finished)

    with locked(out):
        earlier = _check(study, identity, out)  # another command may have begun meanwhile
        remove_drafts(out)
        probed = study.experiment()
        content = {
            "study": study.name,
            "identity": identity,
            "physics": physics_probe(probed.body, probed.kinematics),
            "made_with": [*(one for one in earlier if one != made_with()), made_with()],
        }
        # First: a folder that is not empty is continued only if it says which study it holds.
        write_json(out / STUDY_FILE, content)
        for name in study.folders:
            (out / name).mkdir(exist_ok=True)
            remove_drafts(out / name)
        study.work(out, run_jobs)
        for name in study.folders:  # jobs may be killed after storing their arrays
            remove_files(out / name, lambda file: file.endswith(CHECKPOINT))
        page = study.page(out)
        write_text(out / f"{study.name}.md", page.markdown)
        with style.styled():
            for name, figure in page.figures.items():
                style.save(figure, out, name)
    return page


def _check(study: Study, identity: Mapping[str, Any], out: Path) -> list[Any]:
    """Checks that OUT can hold a study; returns the versions and machines that worked on it."""
    check_folder(out)
    for name in (*study.folders, *study.plans()):
        check_own_folder(out / name)
    path = out / STUDY_FILE
    if not path.is_file():
        if out.is_dir() and not all(map(is_draft, out.iterdir())):
            raise InputError(f"{out} is not empty and holds no study of musebot's")
        return []
    try:
        held = read_json(path)
        name, known, made_with = held["study"], dict(held["identity"]), [*held["made_with"]]
        probe = tuple(map(float, held["physics"]))
    except UNREADABLE as error:
        raise DamagedFileError(f"{path} is no study of musebot's ({error!r:.200})") from error
    if name != study.name:
        raise InputError(f"{out} holds the study {name}, not {study.name}")
    check_identity(out, known, identity, "a study")
    if not is_physics_of(probe, study.experiment()):
        raise InputError(f"{out} was simulated in another physics than this version's")
    return made_with


def simulate_runs(
    out: Path, plans: Mapping[str, Plan], run_jobs: RunJobs, others: Sequence[Job] = ()
) -> None:
    """Simulates the rest of several runs together with other jobs, so that no core waits.

    `plans` holds each run's plan by the name of its folder in OUT.

    Raises:
      InputError: another process simulates a run, or a folder holds another.
    """
    with contextlib.ExitStack() as stack:
        for name in plans:
            stack.enter_context(locked(out / name))
        runs = {out / name: UnfinishedRun.read(out / name, plan) for name, plan in plans.items()}
        for sentence in [sentence for run in runs.values() for sentence in run.begin()]:
            notice(sentence)
        jobs = [*others, *(job for run in runs.values() for job in run.jobs(SAVE_EVERY))]
        jobs.sort(key=lambda job: -job.cost)
        run_jobs(jobs, lambda job: job in others or runs[job.directory].finished(job))
