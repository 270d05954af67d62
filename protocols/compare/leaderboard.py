"""The study that ranks learners by kept runs, between a newborn and a hand-coded robot."""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any, ClassVar

from ..cli.shared_options import Runs, option
from ..errors import InputError
from ..lives.experiment import Experiment
from ..lives.jobs import Job
from ..lives.run import Run
from ..lives.run_files import read_runs
from .boards import Board, Entry, boards
from .costs import FOLDER, cost_jobs, measured
from .leaderboard_page import page
from .study import Page, Study
from .tune import Effort, efforts


@dataclasses.dataclass
class Leaderboard(Study):
    """Rank learners in kept runs, between a newborn and a hand-coded robot.

    Each track, protocol, task, arena and simulator is a board; its runs must hold the agents
    `newborn` and `hand_coded`, which are its bounds. Runs may be kept without their brains.
    """

    name: ClassVar[str] = "leaderboard"

    runs: Runs
    """folders of finished runs of `musebot run`"""
    tuned: Annotated[tuple[Path, ...], option("OUT ..", "none")] = ()
    """folders of `musebot study tune`, whose effort is printed"""

    @functools.cached_property
    def _read(self) -> list[Run]:
        return read_runs(self.runs, networks=False)

    @functools.cached_property
    def _boards(self) -> dict[Board, list[Entry]]:
        if not (found := boards(self._read)):
            raise InputError("the runs hold no learner, only bounds")
        return found

    def experiments(self) -> Mapping[str, Experiment]:
        """See `Study.experiments`."""
        _ = self._boards, self._effort  # refuses runs that make none, and folders of no tuning
        return {run.name: run.experiment for run in self._read}

    def details(self) -> Mapping[str, Any]:
        """See `Study.details`: the effort of tuning."""
        return {"effort": {key: effort.words for key, effort in self._effort.items()}}

    def folders(self, out: Path) -> Sequence[Path]:
        """See `Study.folders`."""
        return [out / FOLDER]

    def check(self, out: Path) -> None:
        """See `Study.check`."""
        measured(out, self._boards)

    def stages(self, out: Path) -> Iterator[Sequence[Job]]:
        """See `Study.stages`: measures each learner once on each board."""
        yield cost_jobs(out, self._boards)

    @functools.cached_property
    def _effort(self) -> dict[str, Effort]:
        return efforts(self.tuned)

    def page(self, out: Path) -> Page:
        """See `Study.page`."""
        return page(self._boards, measured(out, self._boards), self._effort)
