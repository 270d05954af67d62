"""The study of an old brain in a changed body: its options, jobs and files."""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Annotated, ClassVar

from ....models import CHANGES, Kinematics
from ...errors import InputError
from ...experiment.budget import check_memory
from ...experiment.experiment import Body, Experiment
from ...experiment.overrides import named_brain, with_overrides
from ...experiment.plan import Plan, default_cohort_size
from ...shared_options import KinematicsOption, option
from ...simulation.jobs import Job
from ...terminal import notice
from ..study import Page, Study, check_positive
from . import page as pages
from .arms import ARMS
from .branches import BranchJob
from .lives import LifeJob
from .probes import CONDITION
from .recovery import Recovery

LIVES = "lives"


@dataclasses.dataclass
class Wear(Study):
    """Change the body of robots that have learned, and watch how they recover.

    Robots with the brain `steady` learn spot finding for four hours; then the body changes, and
    they learn for four hours more (docs/plans/wear.md). The page shows the arms that are
    finished, also when the study is stopped. Once all are, the folder `lives` can be deleted.
    """

    name: ClassVar[str] = "wear"
    shows_finished: ClassVar[bool] = True

    change: Annotated[tuple[str, ...], option(f"{{{','.join(CHANGES)}}} ..", "polarity")] = (
        "polarity",
    )
    """changes of the body, each from the same lives"""
    arm: Annotated[tuple[str, ...], option("ARM ..", "all 18")] = tuple(ARMS)
    """what is kept of the brains, such as trained-noise-random-old, newborn or frozen"""
    robots: int = 250
    """number of robots in each arm; may be increased later, from one multiple of 250 to another"""
    seed: int = 1
    """seed from which all random streams derive"""
    body: Body = "kinematic"
    """body of the robot; kinematic: the kinematic simulator"""
    kinematics: KinematicsOption = ()
    """parameters of the kinematic simulator, such as lag=0.08"""
    time_scale: float = 1.0
    """factor on every duration, in (0, 1]; below 1 for rehearsals"""

    @functools.cached_property
    def experiment(self) -> Experiment:
        """The experiment of the lives.

        Raises:
          InputError: an option is invalid.
        """
        check_positive(robots=self.robots)
        for what, names, known in (("change", self.change, CHANGES), ("arm", self.arm, ARMS)):
            if not names or len({*names}) < len(names):
                raise InputError(
                    f"{what} must name different ones, got {' '.join(names) or 'none'}"
                )
            for name in names:
                if name not in known:
                    raise InputError(f"the {what} must be one of {', '.join(known)}, got {name!r}")
        return Experiment(
            seed=self.seed,
            cohort_size=default_cohort_size(self.robots),
            time_scale=self.time_scale,
            body=self.body,
            kinematics=with_overrides(Kinematics(), self.kinematics),
            brain=named_brain("steady"),
        )

    def experiments(self) -> Mapping[str, Experiment]:
        """See `Study.experiments`."""
        check_memory(Plan.of(self.experiment, [CONDITION], self.robots))
        return {"life": self.experiment}

    def folders(self, out: Path) -> Sequence[Path]:
        """See `Study.folders`."""
        return [out / LIVES, *(out / change for change in self.change)]

    def check(self, out: Path) -> None:
        """See `Study.check`: reads the files of all jobs."""
        for job in self._branches(out):
            job.shares()
        for life in self._lives(out):
            life.check()

    def stages(self, out: Path) -> Iterator[Sequence[Job]]:
        """See `Study.stages`: the lives that are needed, then all arms.

        A finished study is kept without the lives, which are large. They may be begun again, on
        another machine with other results; then all arms that stem from them are simulated again.
        """
        branches = self._branches(out)
        left = [job.life for job in branches if not job.done()]
        yield [life for life in self._lives(out) if life in left]
        digests = {life.index: old.digest for life in self._lives(out) if (old := life.brains())}
        known = [
            dataclasses.replace(job, digest=digests.get(job.life.index, "")) for job in branches
        ]
        pairs = zip(branches, known, strict=True)
        if again := [str(job) for job, other in pairs if job.done() and not other.done()]:
            notice(f"other brains than the new lives', so these run again: {'; '.join(again)}")
        yield known

    def page(self, out: Path) -> Page:
        """See `Study.page`: what is finished."""
        found: dict[str, dict[str, Recovery]] = {change: {} for change in self.change}
        cohorts: dict[tuple[str, str], list[BranchJob]] = {}
        for job in self._branches(out):
            cohorts.setdefault((job.change, job.arm), []).append(job)
        for (change, arm), jobs in cohorts.items():
            shares = [one for job in jobs if (one := job.shares()) is not None]
            if len(shares) == len(jobs):
                found[change][arm] = Recovery.of(shares)
        return pages.page(found, self.experiment)

    def _lives(self, out: Path) -> list[LifeJob]:
        folder, size = out / LIVES, self.experiment.cohort_size
        return [LifeJob(folder, self.experiment, index) for index in range(self.robots // size)]

    def _branches(self, out: Path) -> list[BranchJob]:
        return [
            BranchJob(out / change, life, change, name)
            for change in self.change
            for name in self.arm
            for life in self._lives(out)
        ]
