"""Studies of runs that each differ from a baseline in one thing; each run has a folder in OUT."""

from __future__ import annotations

import abc
import contextlib
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

from ..errors import InputError
from ..lives.budget import check_memory
from ..lives.experiment import Experiment, check_same
from ..lives.jobs import CohortJob, Job
from ..lives.manifest import MANIFEST, same_physics
from ..lives.plan import Plan, Variant
from ..lives.run import Run
from ..lives.run_files import has_all_robots, planned, read_run
from ..lives.runs import UnfinishedRun
from ..storage import locked, resolved
from ..terminal import notice
from .jobs import SAVE_EVERY
from .study import Study, check_positive


class VariantStudy(Study):
    """A study of several runs, simulated together to keep all cores busy.

    A run's results are in its folder as soon as its own last cohort is done.

    Attributes:
      robots: Number of robots in each condition of each run.
    """

    robots: int

    @property
    def count(self) -> int:
        """Number of robots in each condition of each run."""
        return self.robots

    @abc.abstractmethod
    def baseline(self) -> Experiment:
        """Returns the experiment from which each run differs in one thing.

        Raises:
          InputError: an option is invalid.
        """

    @abc.abstractmethod
    def variants(self) -> Sequence[Variant]:
        """Returns the runs to simulate, the baseline first.

        Raises:
          InputError: an option is invalid.
        """

    def plans(self) -> Mapping[str, Plan]:
        """Returns the plan of the robots to simulate, by the name of the run.

        Raises:
          InputError: an option is invalid.
        """
        check_positive(robots=self.count)
        baseline = self.baseline()
        return {
            variant.name: Plan.of(variant.experiment(baseline), variant.conditions, self.count)
            for variant in self.variants()
        }

    def experiments(self) -> Mapping[str, Experiment]:
        """See `Study.experiments`."""
        return {name: plan.experiment for name, plan in self.plans().items()}

    def folders(self, out: Path) -> Sequence[Path]:
        """See `Study.folders`."""
        return [out / name for name in self.plans()]

    def check(self, out: Path) -> None:
        """See `Study.check`: a run may be continued with more robots, but not with fewer."""
        for name, plan in self.plans().items():
            folder = out / name
            if (held := planned(folder)) is not None:
                self._check_held(folder, held, plan)
            if not has_all_robots(folder, plan):
                check_memory(plan)

    def _check_held(self, folder: Path, held: Plan, plan: Plan) -> None:
        """Raises InputError where a folder's run cannot be continued by a plan."""
        check_same(f"{folder} holds an experiment", held.experiment, plan.experiment)
        for condition, robots in held.robots.items():
            if robots > (wanted := plan.robots.get(condition, 0)):
                raise InputError(
                    f"{folder} holds {robots} robots of {condition}, more than {wanted}"
                )
        if not same_physics(folder):
            raise InputError(f"{folder} was simulated in another physics than this version's")

    def stages(self, out: Path) -> Iterator[Sequence[Job]]:
        """See `Study.stages`: all cohorts of all runs."""
        yield from self.runs(out, self.plans())

    def runs(self, out: Path, plans: Mapping[str, Plan]) -> Iterator[Sequence[Job]]:
        """Yields one group: the cohorts of some runs, which are given by name."""
        with contextlib.ExitStack() as stack:
            for name in plans:
                stack.enter_context(locked(out / name))
            self._unfinished = {
                resolved(out / name): UnfinishedRun.read(out / name, plan)
                for name, plan in plans.items()
            }
            for sentence in (s for run in self._unfinished.values() for s in run.begin()):
                notice(sentence)
            yield [job for run in self._unfinished.values() for job in run.jobs(SAVE_EVERY)]

    def finished(self, job: Job) -> None:
        """See `Study.finished`."""
        if isinstance(job, CohortJob):  # others keep their own files
            self._unfinished[job.directory].finished(job)

    def read(self, out: Path) -> dict[str, Run]:
        """Returns the finished runs by name.

        Raises:
          InputError: a run is missing or damaged.
        """
        runs = {}
        for name in self.plans():
            if not (out / name / MANIFEST).is_file():
                raise InputError(f"{out} lacks the run {name}")
            runs[name] = read_run(out / name)
        return runs
