"""The job of a search: the lives of a cohort, and what they were worth."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any

import numpy as np

from ..agents.trust import trust
from ..errors import InputError, RunError
from ..lives.checkpoints import restored_cohort, save_checkpoint
from ..lives.conditions import CohortKey, Condition
from ..lives.experiment import Experiment
from ..lives.jobs import Report, Stop
from ..lives.schedules import PARTS, Part
from ..storage import remove_files, save_arrays
from .jobs import MinuteTick, StoppedError, advance, identity_of, own_arrays
from .study import CHECKPOINT


@dataclasses.dataclass(frozen=True)
class EvaluationJob:
    """Simulates the lives of a cohort, and stores the time with the event in each part.

    Attributes:
      path: File to which the result is written.
      experiment: Experiment of the robots.
      condition: Condition of the robots.
    """

    path: Path
    experiment: Experiment
    condition: Condition

    def __str__(self) -> str:
        return f"evaluation {self.path.stem}"

    @property
    def cost(self) -> float:
        """See `Job.cost`."""
        schedule = self.experiment.schedule(self.condition.task)
        return self.experiment.robot_seconds(sum(schedule.steps()))

    def done(self) -> bool:
        """See `Job.done`."""
        return self.path.exists()

    def run(self, stop: Stop, report: Report) -> bool:
        """See `Job.run`; lives that were stopped continue from their checkpoint."""
        trust(self.condition.proposer)  # the command has named it
        path, robots = self.path.with_suffix(CHECKPOINT), self.experiment.cohort_size
        cohort, message = restored_cohort(path, self.experiment, CohortKey(self.condition, 0))
        done = self.experiment.robot_seconds(cohort.step)
        report(done, message)
        tick = MinuteTick(self, robots, stop, report, done)
        try:
            advance(cohort, cohort.steps, tick, lambda: save_checkpoint(path, cohort))
        except StoppedError:
            return False
        except (InputError, RunError) as error:  # of an agent
            raise type(error)(f"{error}, in {self} at step {cohort.step}") from error
        lives = cohort.lives()
        arrays = {"events": lives.events.astype(np.int32), "valid": lives.valid}
        save_arrays(self.path, arrays, **self._identity)
        remove_files(path.parent, path.name.__eq__)
        return True

    def shares(self, part: Part = "post") -> np.ndarray:
        """Reads each robot's share of a part of its life with the event, shape (B,).

        A robot whose simulation became unstable counts as the worst.

        Raises:
          DamagedFileError: the file is damaged, or another job's.
        """
        robots = self.experiment.cohort_size
        shapes = {"events": ("I32", (robots, len(PARTS))), "valid": ("BOOL", (robots,))}
        arrays = own_arrays(self.path, shapes, self._identity)
        schedule = self.experiment.schedule(self.condition.task)
        worst = 0.0 if schedule.wanted else 1.0
        events = arrays["events"][:, PARTS.index(part)]
        shares = np.clip(events / schedule.steps_of(part), 0, 1)
        return np.where(arrays["valid"], shares, worst)

    @property
    def _identity(self) -> dict[str, Any]:
        return identity_of(self.experiment, self.condition)
