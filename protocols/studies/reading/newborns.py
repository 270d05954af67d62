"""Stage 1 of the study: the tests before training of newborns, a job for each cohort."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any

import numpy as np

from ...experiment.conditions import CohortKey, Condition
from ...experiment.experiment import Experiment
from ...simulation.cohort import Cohort
from ...simulation.jobs import Report, Stop
from ..jobs import FileJob, MinuteTick, advance, identity_of


@dataclasses.dataclass(frozen=True)
class NewbornJob(FileJob):
    """Simulates the tests before training of a cohort, and stores the time of the event.

    Attributes:
      folder: Folder of the file, an absolute path.
      cell: Name of the experiment.
      experiment: Experiment of the robots.
      condition: Condition of the robots.
    """

    folder: Path
    cell: str
    experiment: Experiment
    condition: Condition

    def __str__(self) -> str:
        return f"{self.cell}, {self.condition}"

    @property
    def path(self) -> Path:
        """See `Job.path`."""
        return self.folder / f"{self.cell}-{self.condition.proposer}.safetensors"

    @property
    def cost(self) -> float:
        """See `Job.cost`."""
        return self.experiment.robot_seconds(self._steps)

    @property
    def _steps(self) -> int:
        return self.experiment.schedule(self.condition.task).steps_of("pre")

    def work(self, stop: Stop, report: Report) -> dict[str, np.ndarray]:
        """See `FileJob.work`."""
        cohort = Cohort(self.experiment, CohortKey(self.condition, 0))
        tick = MinuteTick(self, self.experiment.cohort_size, stop, report)
        advance(cohort, self._steps, tick)
        return {"steps": cohort.lives().events[:, 0]}

    def unmet(self) -> np.ndarray | None:
        """Returns whether each robot has no event, shape (B,); None if the job is not done."""
        return self.steps() == 0 if self.done() else None

    def steps(self) -> np.ndarray:
        """Reads the steps with the event in each robot's test, shape (B,).

        Raises:
          DamagedFileError: the file is damaged, or another job's.
        """
        shapes = {"steps": ("I32", (self.experiment.cohort_size,))}
        return self.read(shapes)["steps"]

    @property
    def identity(self) -> dict[str, Any]:
        """See `FileJob.identity`."""
        names = {"cell": self.cell, "proposer": self.condition.proposer}
        return names | identity_of(self.experiment, self.condition)
