"""Studies of several runs that differ in one thing each, a folder of OUT for each run."""

from __future__ import annotations

import abc
import contextlib
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from ..errors import InputError
from ..experiment.experiment import Experiment, check_same
from ..experiment.manifest import MANIFEST, same_physics
from ..experiment.plan import Plan
from ..results.run import Run
from ..results.run_files import planned, read_run
from ..simulation.engine import UnfinishedRun
from ..simulation.jobs import CohortJob, Job
from ..storage import locked
from ..terminal import notice
from .study import Page, Study


class VariantStudy(Study):
    """Runs that are simulated together, so that a run of few cohorts leaves no core idle.

    A run's results are in its folder as soon as its own last cohort is done.
    """

    @abc.abstractmethod
    def plans(self) -> Mapping[str, Plan]:
        """Returns the robots that are wanted, by the name of the run.

        Raises:
          InputError: an option is invalid.
        """

    @abc.abstractmethod
    def report(self, runs: Mapping[str, Run]) -> Page:
        """Returns the page made from the finished runs, by name."""

    def experiments(self) -> Mapping[str, Experiment]:
        """See `Study.experiments`."""
        return {name: plan.experiment for name, plan in self.plans().items()}

    def details(self) -> Mapping[str, Any]:
        """See `Study.details`: the number of robots of each condition."""
        plans = self.plans().items()
        return {"robots": {n: {str(c): r for c, r in p.robots.items()} for n, p in plans}}

    def folders(self, out: Path) -> Sequence[Path]:
        """See `Study.folders`."""
        return [out / name for name in self.plans()]

    def check(self, out: Path) -> None:
        """See `Study.check`."""
        for name, plan in self.plans().items():
            folder = out / name
            if (held := planned(folder)) is None:
                continue
            check_same(f"{folder} holds an experiment", held.experiment, plan.experiment)
            for condition, robots in held.robots.items():
                if robots > (wanted := plan.robots.get(condition, 0)):
                    raise InputError(
                        f"{folder} holds {robots} robots of {condition}, more than {wanted}"
                    )
            if not same_physics(folder):
                raise InputError(f"{folder} was simulated in another physics than this version's")

    def stages(self, out: Path) -> Iterator[Sequence[Job]]:
        """See `Study.stages`."""
        plans = self.plans().items()
        with contextlib.ExitStack() as stack:
            for folder in self.folders(out):
                stack.enter_context(locked(folder))
            self._unfinished = {
                (out / name).resolve(): UnfinishedRun.read(out / name, plan) for name, plan in plans
            }
            for sentence in (s for run in self._unfinished.values() for s in run.begin()):
                notice(sentence)
            yield [job for run in self._unfinished.values() for job in run.jobs(save_every=60.0)]

    def finished(self, job: Job) -> None:
        """See `Study.finished`."""
        assert isinstance(job, CohortJob)
        self._unfinished[job.directory].finished(job)

    def page(self, out: Path) -> Page:
        """See `Study.page`."""
        runs = {}
        for name in self.plans():
            if not (out / name / MANIFEST).is_file():
                raise InputError(f"{out} lacks the run {name}")
            runs[name] = read_run(out / name)
        return self.report(runs)
