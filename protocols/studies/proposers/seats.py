"""Seats: trained brains that propose actions in another way than the one they learned with."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from ...agents.factory import make_agent
from ...errors import RunError
from ...experiment.conditions import Condition
from ...experiment.experiment import Experiment
from ...experiment.schedules import control_steps
from ...playback.rollout import count_events
from ...results.run import Run
from ...results.run_files import read_run
from ...simulation.jobs import Report, Stop
from ...simulation.placement import place
from ..jobs import FileJob, MinuteTick, check_shares, identity_of
from .cells import WAYS, Cell

FOLDER = "seats"
_TASK, _IDEAS = "spot_finding", 25
_PART_OF_TEST = 1 / 3
_SEED = 0  # of the noise in the tests

# Under these ways every brain is tested: they need no memory, or one as born.
_FREE = ("untrained", "uniform", "sobol", "cross-entropy")
_MEMORIES = ("connections", "with-main-idea", "main-idea-uniform", "copies", "action")


def seats(cells: Sequence[Cell]) -> list[tuple[Cell, Cell]]:
    """Returns pairs: the cell in which brains were trained, and that in which they are tested.

    Left out are test ways whose memory the trained brains do not have.

    Args:
      cells: Simulated cells.
    """
    own = [cell for cell in cells if cell.ideas == _IDEAS and not cell.outside]
    return [(trained, test) for trained in own for test in own if _fits(trained.way, test.way)]


def _fits(trained: str, test: str) -> bool:
    if test in _FREE:
        return True
    if test in _MEMORIES:
        return trained in (*_MEMORIES, "untrained")
    return trained == test


@dataclasses.dataclass(frozen=True)
class SeatJob(FileJob):
    """Tests trained brains of a cell's first cohort, with frozen weights, under another way.

    Attributes:
      out: Folder of the study, an absolute path.
      experiment: Experiment in which the brains were trained.
      trained: Cell in which they were trained.
      test: Cell in which they are tested.
    """

    out: Path
    experiment: Experiment
    trained: Cell
    test: Cell

    def __str__(self) -> str:
        return f"brains of {self.trained.way} under {self.test.way}"

    @property
    def path(self) -> Path:
        """See `Job.path`."""
        return self.out / FOLDER / f"{self.trained.way}-under-{self.test.way}.safetensors"

    @property
    def cost(self) -> float:
        """See `Job.cost`."""
        return self.experiment.robot_seconds(self._steps)

    def work(self, stop: Stop, report: Report) -> dict[str, np.ndarray]:
        """See `FileJob.work`."""
        run = read_run(self.out / self.trained.name)
        condition = _condition(self.trained)
        rows = [row for row in run.valid_rows(condition) if row < self._robots]
        if not rows:
            raise RunError(f"{self.trained.name}: every simulation became unstable")
        return {"shares": self._shares(run, rows, MinuteTick(self, len(rows), stop, report))}

    def shares(self) -> np.ndarray:
        """Reads each brain's share of the test with the event; NaN where it became unstable.

        Raises:
          DamagedFileError: the file is damaged, or another job's.
        """
        shapes = {"shares": ("F64", (self._robots,))}
        shares = self.read(shapes)["shares"]
        check_shares(self.path, shares)
        return shares

    @property
    def _robots(self) -> int:
        return self.experiment.cohort_size

    @property
    def _steps(self) -> int:
        return control_steps(self.experiment.schedule(_TASK).phases[-1].minutes * _PART_OF_TEST)

    @property
    def identity(self) -> dict[str, Any]:
        """See `FileJob.identity`."""
        names = {"trained": self.trained.name, "test": self.test.name, "seed": _SEED}
        return names | identity_of(self.experiment, _condition(self.trained))

    def _shares(self, run: Run, rows: Sequence[int], tick: MinuteTick) -> np.ndarray:
        before, now = _condition(self.trained), _condition(self.test)
        experiment = self.test.experiment(self.experiment)
        agent = make_agent(experiment, now, len(rows), _SEED)
        weights = agent.weights()
        for name, array in run.networks(before, "after").items():
            # A memory as born is the newly drawn one.
            if name in weights and not (name.startswith("memory.") and self.test.way in _FREE):
                weights[name] = array[rows]
        agent.load_weights(weights)
        batch = experiment.batch(now.task, len(rows))
        place(batch, experiment.schedule(now.task).phases[-1], np.random.default_rng(_SEED))
        counts = count_events(batch, agent, self._steps, tick=tick)
        shares = np.full(self._robots, np.nan)
        shares[rows] = np.where(batch.valid, counts / self._steps, np.nan)
        return shares


def _condition(cell: Cell) -> Condition:
    return Condition(_TASK, WAYS[cell.way].proposer)
