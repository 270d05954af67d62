"""The study of readings of the paper: a hypothesis, newborns, a screening, and finalists."""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import ClassVar

from ....controller import PROPOSERS
from ...errors import InputError
from ...experiment.budget import check_memory
from ...experiment.conditions import PAPER_TASKS, Condition
from ...experiment.experiment import Experiment
from ...experiment.plan import Plan, Variant, changed
from ...reporting.labels import durations
from ...results.run_files import ROBOTS_FILE, Needs, read_so_far
from ...simulation.jobs import Job
from ..study import Page, check_positive
from ..variants import VariantStudy
from . import page
from .choices import DESIGN, FINALISTS, PLAIN, SEEDS, SPEEDS, WALLS, combined, plain
from .newborns import NewbornJob

NEWBORNS = "newborns"  # folder of stage 1


@dataclasses.dataclass
class Reading(VariantStudy):
    """Compare readings of the paper by what they make of its tables.

    Stage 0 simulates the plain reading, stage 1 the tests before training of newborns with
    other walls, speeds, contacts and places of the nose, stage 2 creative robots with twelve
    combinations of eight choices, stage 3 the finalists (docs/plans/reading.md). The page shows
    what is finished, also when the study is stopped.
    """

    name: ClassVar[str] = "reading"
    shows_finished: ClassVar[bool] = True
    needs: ClassVar[Needs] = "rows"

    robots: int = 500
    """number of robots in each condition of stage 0"""
    newborns: int = 250
    """number of robots in each cell of stage 1"""
    screened: int = 250
    """number of robots in each cell of stage 2"""
    finalists: int = 500
    """number of robots in each condition of stage 3"""
    stage: int = 3
    """last stage to simulate: 0, 1, 2 or 3"""
    time_scale: float = 1.0
    """factor on every duration, in (0, 1]; below 1 for rehearsals"""

    def baseline(self) -> Experiment:
        """See `VariantStudy.baseline`."""
        return plain(SEEDS[0], self.robots, self.time_scale)

    def variants(self) -> Sequence[Variant]:
        """See `VariantStudy.variants`."""
        return [Variant(PLAIN, {})]

    def check(self, out: Path) -> None:
        """See `VariantStudy.check`; the newborns' files are read, too."""
        super().check(out)
        for experiment, task in self.cells().values():
            check_memory(Plan.of(experiment, [Condition(task, "creative")], self.newborns))
        for job in self.newborn_jobs(out):
            if job.done():
                job.steps()

    def screen(self) -> Mapping[str, Plan]:
        """Returns the plans of stage 2, by name."""
        start = plain(SEEDS[2], self.screened, self.time_scale)
        creative = [Condition(task, "creative") for task in PAPER_TASKS]
        return {
            f"screen-{number:02}": Plan.of(combined(start, row), creative, self.screened)
            for number, row in enumerate(DESIGN, start=1)
        }

    def finals(self) -> Mapping[str, Plan]:
        """Returns the plans of stage 3, by name."""
        start = plain(SEEDS[3], self.finalists, self.time_scale)
        return {
            name: Plan.of(finalist.experiment(start), finalist.conditions, self.finalists)
            for name, finalist in FINALISTS.items()
        }

    def plans(self) -> Mapping[str, Plan]:
        """See `VariantStudy.plans`: the runs of stages 0, 2 and 3."""
        check_positive(newborns=self.newborns, screened=self.screened, finalists=self.finalists)
        if self.stage not in (0, 1, 2, 3):
            raise InputError(f"stage must be 0, 1, 2 or 3, got {self.stage}")
        return {**super().plans(), **self.screen(), **self.finals()}

    def experiments(self) -> Mapping[str, Experiment]:
        """See `Study.experiments`."""
        return {**super().experiments(), **{n: one for n, (one, _) in self.cells().items()}}

    def cells(self) -> Mapping[str, tuple[Experiment, str]]:
        """Returns the experiments of stage 1 and their tasks, by name, in their order."""
        start = plain(SEEDS[1], self.newborns, self.time_scale)
        found = {}
        for speed, wall, second in itertools.product(SPEEDS, WALLS, (0, 1)):
            base = changed(start, {"motor_speed": speed, "kinematics.wall": wall})
            felt, place = ("pushed", "near")[second], ("centre", "front")[second]
            name = f"{wall}-{round(1000 * speed)}mm"
            walls = changed(base, {"kinematics.felt": felt})
            found[f"walls-{name}-{felt}"] = walls, "wall_avoidance"
            spot = changed(base, {"nose_place": place})
            found[f"spot-{name}-{place}"] = spot, "spot_finding"
        return found

    def folders(self, out: Path) -> Sequence[Path]:
        """See `Study.folders`."""
        return [*super().folders(out), out / NEWBORNS]

    def newborn_jobs(self, out: Path) -> list[NewbornJob]:
        """Returns the jobs of stage 1."""
        return [
            NewbornJob(out / NEWBORNS, name, experiment, Condition(task, proposer))
            for name, (experiment, task) in self.cells().items()
            for proposer in PROPOSERS
        ]

    def stages(self, out: Path) -> Iterator[Sequence[Job]]:
        """See `Study.stages`."""
        yield from self.runs(out, super().plans())
        if self.stage > 0:
            yield self.newborn_jobs(out)
        if self.stage > 1:
            yield from self.runs(out, self.screen())
        if self.stage > 2:
            yield from self.runs(out, self.finals())

    def page(self, out: Path) -> Page:
        """See `Study.page`: what is finished."""
        names = [name for name in self.plans() if (out / name / ROBOTS_FILE).is_file()]
        runs = {name: read_so_far(out / name, "rows") for name in names}
        screened = {name: runs[name] for name in self.screen() if name in runs}
        parts = [f"Rehearsal{scale}.\n"] if (scale := durations(self.baseline())) else []
        parts += [page.hypothesis(runs[PLAIN])] if PLAIN in runs else []
        parts += page.newborns(self.newborn_jobs(out), self.newborns)
        parts += page.screening(screened)
        parts += page.finals(runs)
        return Page("\n".join(parts) or "Nothing is finished yet.\n")
