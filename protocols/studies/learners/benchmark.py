"""The study that simulates learners in the same lives, and ranks them (docs/plans/learners.md)."""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from types import MappingProxyType
from typing import Annotated, Any, ClassVar, Literal, get_args

from ....controller import PROPOSERS
from ...agents.factory import factory_of
from ...agents.names import recorded_name, short_name
from ...agents.trust import trust
from ...errors import InputError
from ...experiment.experiment import Body, Experiment, Signals
from ...experiment.overrides import named_brain, with_overrides
from ...results.run import Run
from ...results.run_files import has_all_rows, read_runs
from ...shared_options import option
from ...simulation.jobs import CohortJob, Job
from ..study import Page, check_positive
from ..variants import Variant, VariantStudy
from .boards import LOWER, UPPER, saturates
from .ranking import FOLDER, cost_jobs, ranking
from .tune import Tune, efforts

LEARNERS = ("q_learner", "sarsa_lambda", "stream_q", "stream_ac", "avg", "amortised_q", "dqn")
_BRAINS = ("paper", "steady")
_SATURATED = ("raw_signals=false", "raw_reward=false")  # `steady` with the paper's signals

BoardName = Literal["paper", "walls", "continual", "larger"]
BOARDS: Mapping[BoardName, Mapping[str, Any]] = MappingProxyType(
    {
        "paper": {},
        "walls": {"protocol": "walls"},
        "continual": {"protocol": "continual", "seed": 32011},
        "larger": {"arena_scale": 1.3333, "seed": 32012},
    }
)


@dataclasses.dataclass
class Benchmark(VariantStudy):
    """Simulate learners in the same lives, each with its tuned settings, and rank them.

    Each learner has a run of its own in each track, and so have both bounds, the paper's robots and
    `steady`. The page shows the runs that are finished, and needs no brains. More learners, tracks
    and boards may be added later.
    """

    name: ClassVar[str] = "benchmark"
    needs: ClassVar[Literal["brains", "curves", "rows"]] = "curves"

    tuned: Annotated[tuple[Path, ...], option("OUT ..", "none")] = ()
    """folders of `musebot study tune`; other learners have their default settings"""
    agent: Annotated[tuple[str, ...], option("NAME ..", "all of ours, without ppo")] = (
        *_BRAINS,
        *LEARNERS,
    )
    """learners: agents, or a brain, paper or steady"""
    signals: Annotated[tuple[Signals, ...], option("{paper,raw} ..", "both")] = ("paper", "raw")
    """tracks; raw: smell and reward before they saturate"""
    board: Annotated[tuple[BoardName, ...], option(f"{{{','.join(BOARDS)}}} ..", "paper walls")] = (
        "paper",
        "walls",
    )
    """paper: both tasks; walls: spot finding with walls sensed; continual: a day; larger: spot
    finding in an arena a third larger"""
    robots: int = 60
    """number of robots of each learner, one cohort"""
    seed: int = 32010
    """seed of the boards paper and walls"""
    body: Body = "mujoco"
    """body of the robot; kinematic: the kinematic simulator"""
    time_scale: float = 1.0
    """factor on every duration, in (0, 1]; below 1 for rehearsals"""

    def baseline(self) -> Experiment:
        """See `VariantStudy.baseline`."""
        check_positive(robots=self.robots)
        return Experiment(
            seed=self.seed,
            cohort_size=self.robots,
            body=self.body,
            time_scale=self.time_scale,
        )

    def variants(self) -> Sequence[Variant]:
        """See `VariantStudy.variants`: for each board the bounds, and each learner's tracks."""
        if not (self.agent and self.signals and self.board):
            raise InputError("at least one agent, one track and one board are needed")
        for signals in self.signals:
            if signals not in get_args(Signals):
                raise InputError(f"the signals must be one of paper, raw, got {signals!r:.60}")
        found = []
        for board in dict.fromkeys(self.board):
            if board not in BOARDS:
                raise InputError(f"the board must be one of {', '.join(BOARDS)}, got {board!r:.60}")
            fields = BOARDS[board]
            tasks = tuple(dataclasses.replace(self.baseline(), **fields).tasks)
            if board == "larger":
                tasks = tasks[-1:]
            bounds = tuple(map(recorded_name, (LOWER, UPPER)))
            found.append(Variant(f"{board}-bounds", "the bounds", fields, tasks, bounds))
            found += self._rows(board, fields, tasks)
        return found

    def _rows(
        self, board: str, fields: Mapping[str, Any], tasks: tuple[str, ...]
    ) -> Iterator[Variant]:
        for name in dict.fromkeys(self.agent):
            for signals in dict.fromkeys(self.signals):
                row = f"{board}-{short_name(name).replace(':', '-')}-{signals}"
                if name not in _BRAINS:
                    recorded = recorded_name(name)
                    settings = self._settings.get((recorded, signals), ())
                    chosen = {"signals": signals, "settings": settings}
                    yield Variant(row, name, {**fields, **chosen}, tasks, (recorded,))
                elif name == "paper" and signals == "paper":
                    yield Variant(row, name, fields, tasks, PROPOSERS)
                elif name == "steady":
                    brain = named_brain(name)
                    # Where nothing saturates, both tracks are the same.
                    start = dataclasses.replace(self.baseline(), **fields)
                    own = tuple(t for t in tasks if signals == "raw" or saturates(start, t))
                    if signals == "paper":
                        brain = with_overrides(brain, _SATURATED)
                    if own:
                        yield Variant(row, name, {**fields, "brain": brain}, own, ("creative",))

    @functools.cached_property
    def _settings(self) -> Mapping[tuple[str, str], tuple[str, ...]]:
        """The best settings of each tuned agent of the command, by its name and track."""
        named = {recorded_name(name) for name in self.agent if name not in _BRAINS}
        for name in named:
            trust(name)
            factory_of(name)
        found: dict[tuple[str, str], tuple[str, ...]] = {}
        for folder in self.tuned:
            study = Tune.read(folder)
            key = recorded_name(study.agent), study.signals
            if key in found:
                raise InputError(f"{study.agent} with {study.signals} signals was tuned twice")
            if key[0] in named:  # no other agent's code may run
                found[key] = study.best(folder).settings
        return found

    def folders(self, out: Path) -> Sequence[Path]:
        """See `Study.folders`."""
        return [*super().folders(out), out / FOLDER]

    def stages(self, out: Path) -> Iterator[Sequence[Job]]:
        """See `Study.stages`: all lives, then what each learner costs."""
        yield from super().stages(out)
        yield cost_jobs(out, self._finished(out))

    def finished(self, job: Job) -> None:
        """See `Study.finished`."""
        if isinstance(job, CohortJob):
            super().finished(job)

    def page(self, out: Path) -> Page:
        """See `Study.page`: what is finished."""
        runs = self._finished(out)
        return self.report({run.name: run for run in runs}, out)

    def report(self, runs: Mapping[str, Run], out: Path = Path()) -> Page:
        """See `VariantStudy.report`; costs are read in the folder OUT."""
        return ranking(out, [*runs.values()], efforts(self.tuned))

    def _finished(self, out: Path) -> list[Run]:
        done = [out / n for n, plan in self.plans().items() if has_all_rows(out / n, plan)]
        return read_runs(done, brains=False)
