"""The job that measures what a learner costs: its time and its memory."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np

from ...agents.agent_check import Costs, costs
from ...experiment.conditions import Condition
from ...experiment.experiment import Experiment
from ...simulation.jobs import Report, Stop
from ...storage import save_arrays
from ..study import identity_of, own_arrays


@dataclasses.dataclass(frozen=True)
class CostJob:
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
        """See `Job.cost`."""
        return 1.0

    def done(self) -> bool:
        """See `Job.done`."""
        return self.path.exists()

    def run(self, stop: Stop, report: Report) -> bool:
        """See `Job.run`; takes seconds."""
        del stop
        found = costs(self.experiment, self.condition)
        identity = identity_of(self.experiment, self.condition)
        save_arrays(self.path, {"costs": np.array(found, np.float64)}, **identity)
        report(self.cost, "")
        return True

    def costs(self) -> Costs:
        """Reads the result.

        Raises:
          DamagedFileError: the file is damaged, or another learner's.
        """
        identity = identity_of(self.experiment, self.condition)
        arrays = own_arrays(self.path, {"costs": ("F64", (3,))}, identity)
        return Costs._make(arrays["costs"].tolist())
