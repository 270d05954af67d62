"""Studies: jobs with result files, and a page made from these. Handles resuming and locking."""

from __future__ import annotations

import abc
import contextlib
import dataclasses
import json
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar

from ...controller.parameters import shown
from ..errors import DamagedFileError, InputError, Interrupted, RunError
from ..lives.experiment import Experiment, check_same, experiment_from
from ..lives.jobs import Executor, Job, execute
from ..lives.manifest import UNREADABLE, is_physics_of, machine, physics_probe
from ..lives.plan import MOST_ROBOTS
from ..pages import style
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

if TYPE_CHECKING:
    from matplotlib.figure import Figure

STUDY_FILE = "study.json"
CHECKPOINT = ".checkpoint"  # ending of a job's file from which it continues
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
    for detail, wanted in json.loads(json.dumps(study.details())).items():  # tuples as lists
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
