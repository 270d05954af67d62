"""The jobs that measure what learners cost: their time and their memory."""

from __future__ import annotations

import dataclasses
import zlib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from ...tasks.arena import CONTROL_TIMESTEP
from ..agents.names import TRAINED_BEFORE, is_own
from ..compare.agent_check import TIMED, Costs, costs
from ..lives.conditions import Condition
from ..lives.experiment import Experiment
from ..lives.jobs import Report, Stop
from .boards import Board, Entry
from .jobs import FileJob, identity_of

FOLDER = "costs"
Boards = Mapping[Board, Sequence[Entry]]
Measured = Mapping[Board, Mapping[str, Costs]]
"""What learners cost, by board and name."""

_LONGEST = 100  # characters of a learner in the name of a file


@dataclasses.dataclass(frozen=True)
class CostJob(FileJob):
    """Measures a learner once and stores the result, so that its page can be made again.

    Attributes:
      path: File to which the result is written.
      experiment: Experiment with the brain, or with the agent's settings and signals.
      condition: Condition of the learner.
    """

    path: Path
    experiment: Experiment
    condition: Condition

    def __str__(self) -> str:
        return f"costs of {self.path.stem}"

    @property
    def cost(self) -> float:
        """See `Job.cost`: the learner and the paper's brain are measured."""
        robots, steps = TIMED
        return 2 * robots * steps * CONTROL_TIMESTEP

    @property
    def identity(self) -> dict[str, Any]:
        """See `FileJob.identity`."""
        return identity_of(self.experiment, self.condition)

    def work(self, stop: Stop, report: Report) -> dict[str, np.ndarray]:
        """See `FileJob.work`; takes seconds."""
        del stop
        found = costs(self.experiment, self.condition)
        report(self.cost, "")
        return {"costs": np.array(found, np.float64)}

    def costs(self) -> Costs:
        """Reads the result.

        Raises:
          DamagedFileError: the file is damaged, or another learner's.
        """
        return Costs._make(self.read({"costs": ("F64", (3,))})["costs"].tolist())


def cost_jobs(out: Path, found: Boards) -> list[CostJob]:
    """Returns the jobs that measure what our own learners cost.

    Without `ppo`: its number of robots is that of its policies.
    """
    return [
        _cost_job(out, board, entry)
        for board, entries in found.items()
        for entry in entries
        if is_own(entry.condition.proposer) and entry.name != TRAINED_BEFORE
    ]


def measured(out: Path, found: Boards) -> Measured:
    """Returns what was measured of each learner, by its board and its name.

    Raises:
      DamagedFileError: a file is damaged, or another learner's.
    """
    jobs = {
        board: {entry.name: _cost_job(out, board, entry) for entry in entries}
        for board, entries in found.items()
    }
    return {
        board: {name: job.costs() for name, job in own.items() if job.done()}
        for board, own in jobs.items()
    }


def _cost_job(out: Path, board: Board, entry: Entry) -> CostJob:
    learner = entry.name.replace(", ", "-").replace(" ", "-")
    if len(learner) > _LONGEST:  # a brain with many changes: the file's name would be too long
        learner = f"{learner[:_LONGEST]}-{zlib.crc32(learner.encode()):08x}"
    name = f"{board.name}-{learner}"
    return CostJob(out / FOLDER / f"{name}.safetensors", entry.experiment, entry.condition)
