"""The study of ways to propose actions: its runs, and the seats of their brains."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import ClassVar

from ...experiment.experiment import Experiment
from ...experiment.plan import Variant, default_cohort_size
from ...reporting.labels import durations
from ...results.run_files import Needs, has_all_rows, read_so_far
from ...simulation.jobs import Job
from ..study import Page
from ..variants import VariantStudy
from . import page
from .cells import PARTS, WAYS, Part, PartName
from .page import Outcome
from .seats import FOLDER, SeatJob, seats


@dataclasses.dataclass
class Proposers(VariantStudy):
    """Compare ways to propose equally many actions to the same evaluation network.

    Each part has a folder of its own (docs/plans/proposers.md): `first` compares the ways,
    `outside` further ones with outside ideas, `rule` the one-fifth rule, `mujoco` three ways in
    MuJoCo, `paper` the paper's brain, `context` a recurrent context. The page shows the cells that
    are finished, and needs only robots.csv.
    """

    name: ClassVar[str] = "proposers"
    shows_finished: ClassVar[bool] = True
    needs: ClassVar[Needs] = "rows"

    part: PartName = "first"
    """part of the study"""
    robots: int = 0
    """number of robots in each cell; 0 for the plan's number"""
    time_scale: float = 1.0
    """factor on every duration, in (0, 1]; below 1 for rehearsals"""

    @property
    def count(self) -> int:
        """See `VariantStudy.count`."""
        return self.robots or self.chosen.robots

    @property
    def chosen(self) -> Part:
        """The part of the study."""
        return PARTS[self.part]

    def baseline(self) -> Experiment:
        """See `VariantStudy.baseline`."""
        size = default_cohort_size(self.count, most=self.chosen.cohort)
        return self.chosen.start(size, self.time_scale)

    def variants(self) -> Sequence[Variant]:
        """See `VariantStudy.variants`: a run for each cell."""
        start = self.baseline()
        return [
            Variant(
                cell.name,
                {"brain": cell.experiment(start).brain},
                tuple(self.chosen.tasks),
                (WAYS[cell.way].proposer,),
            )
            for cell in self.chosen.cells
        ]

    def folders(self, out: Path) -> Sequence[Path]:
        """See `Study.folders`."""
        return [*super().folders(out), *([out / FOLDER] if self._seats(out) else [])]

    def check(self, out: Path) -> None:
        """See `VariantStudy.check`; the files of the seats are read, too."""
        super().check(out)
        for job in self._seats(out):
            if job.done():
                job.shares()

    def stages(self, out: Path) -> Iterator[Sequence[Job]]:
        """See `Study.stages`: the cohorts of all runs, then the seats."""
        yield from self.runs(out, self.plans())
        yield self._seats(out)

    def page(self, out: Path) -> Page:
        """See `Study.page`: what is finished."""
        plans = self.plans()
        found = [
            Outcome.of(cell, read_so_far(folder, "rows"), condition)
            for cell in self.chosen.cells
            if has_all_rows(folder := out / cell.name, plans[cell.name])
            for condition in self.chosen.conditions(cell)
        ]
        tested = {(job.trained, job.test): job.shares() for job in self._seats(out) if job.done()}
        scale = durations(next(iter(plans.values())).experiment)
        return page.page(self.part, self.chosen, scale, found, tested)

    def _seats(self, out: Path) -> list[SeatJob]:
        if self.part != "first":
            return []
        start = self.baseline()
        return [SeatJob(out, start, trained, test) for trained, test in seats(self.chosen.cells)]
