"""`--tensorboard`: the mean learning curve of each condition, in event files in `OUT/tensorboard`.

Each `musebot run` writes all minutes anew; TensorBoard drops earlier ones (`purge_step`).
"""

from __future__ import annotations

import time
from typing import TYPE_CHECKING

from torch.utils.tensorboard import SummaryWriter

from ..errors import InputError
from ..storage import check_own_folder
from ..terminal import notice
from .conditions import Condition

if TYPE_CHECKING:
    from .simulation import UnfinishedRun


class TensorBoardLog:
    """Log of the mean share of each simulated minute, from 1: `contact`, `in_spot` or `at_goal`."""

    def __init__(self, run: UnfinishedRun, every: float) -> None:
        """Takes a run that has begun; `every` is the wall-clock seconds between updates."""
        self._run, self._every, self._updated = run, every, time.monotonic()
        self._written = dict.fromkeys(run.plan.robots, 0)  # minutes written, by condition
        self._writers: dict[Condition, SummaryWriter] = {}

    def update(self, now: bool = False) -> None:
        """Writes new minutes if an update is due, or `now`; a failure ends the log, not the run."""
        if not now and time.monotonic() - self._updated < self._every:
            return
        self._updated = time.monotonic()
        try:
            for condition, first in self._written.items():
                event = self._run.plan.experiment.life_of(condition.life).event
                tag = {"in contact": "contact", "in the spot": "in_spot"}.get(event, "at_goal")
                shares = self._run.curve(condition)[first:]
                for minute, share in enumerate(shares, first + 1):
                    self._writer(condition).add_scalar(tag, share, minute)
                self._written[condition] = first + len(shares)
            for writer in self._writers.values():
                writer.flush()
        except (OSError, InputError) as error:
            notice(f"the log of TensorBoard ends here ({error}); the run goes on")
            self._written, self._writers = {}, {}

    def _writer(self, condition: Condition) -> SummaryWriter:
        if condition not in self._writers:
            name = f"{condition.life}-{condition.proposer}-{self._run.plan.robots[condition]}"
            folder = self._run.directory / "tensorboard" / name.replace(":", ".")
            check_own_folder(folder.parent)
            check_own_folder(folder)
            self._writers[condition] = SummaryWriter(str(folder), purge_step=1)
        return self._writers[condition]
