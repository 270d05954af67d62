"""The study that simulates learners by the same schedules, and ranks them."""

from __future__ import annotations

import dataclasses
import functools
import itertools
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from types import MappingProxyType
from typing import Annotated, Any, ClassVar, Literal, get_args

from ...controller import PROPOSERS
from ...models import Kinematics
from ..agents.factory import factory_of
from ..agents.names import (
    RECORDED_NAMES,
    TRAINED_BEFORE,
    name_in_track,
    recorded_name,
    short_name,
)
from ..agents.trust import trust
from ..cli.shared_options import BODY_EFFECTS, option
from ..errors import InputError
from ..lives.cohort import check_agents
from ..lives.experiment import Body, Experiment, Signals
from ..lives.jobs import Job
from ..lives.overrides import named_brain, with_overrides
from ..lives.plan import Variant
from ..lives.run_files import has_all_robots, read_runs
from ..terminal import notice
from .boards import LOWER, UPPER, Board, Entry, boards, saturates
from .costs import FOLDER, cost_jobs, measured
from .leaderboard_page import page
from .study import Page
from .tune import efforts, tunings
from .variants import VariantStudy

LEARNERS = tuple(name for name in RECORDED_NAMES if name not in (TRAINED_BEFORE, LOWER, UPPER))
_BRAINS = ("paper", "steady")
_PAPER_ALONE = ("paper", recorded_name(TRAINED_BEFORE))  # have no raw signals
_SATURATED = ("raw_signals=false", "raw_reward=false")  # `steady` with the paper's signals
# In MuJoCo 30 robots can become 60 later. Kinematic robots are cheaper in larger cohorts.
_COHORTS: Mapping[Body, int] = MappingProxyType({"mujoco": 30, "kinematic": 60})

BoardName = Literal["paper", "walls"]
BOARDS: Mapping[BoardName, Mapping[str, Any]] = MappingProxyType(
    {
        "paper": {},
        "walls": {"protocol": "walls"},
    }
)


@dataclasses.dataclass
class Benchmark(VariantStudy):
    """Simulate learners by the same schedules, each with its tuned settings, and rank them.

    On each board each learner has one run per track. The bounds newborn and hand_coded have one
    run per board, which counts in both tracks. The page needs no brains. More learners, tracks
    or boards can be added to those that OUT has. Boards: paper, both tasks; walls, spot finding
    with walls sensed.
    """

    name: ClassVar[str] = "benchmark"

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
    """protocols and tasks in which they are compared"""
    robots: int = 60
    """robots of each learner: at most 30, or a multiple of 30; with --body kinematic of 60"""
    seed: int = 32010
    """seed of the boards paper and walls"""
    body: Body = "mujoco"
    """body of the robot; kinematic: the kinematic simulator, with the effects of the body"""
    time_scale: float = 1.0
    """factor on every duration, in (0, 1]; below 1 for rehearsals"""

    def baseline(self) -> Experiment:
        """See `VariantStudy.baseline`."""
        if (cohort := _COHORTS.get(self.body)) is None:
            names = ", ".join(_COHORTS)
            raise InputError(f"the body must be one of {names}, got {self.body!r:.60}")
        if self.robots > cohort and self.robots % cohort:
            raise InputError(
                f"robots above {cohort} must be a multiple of {cohort}, got {self.robots}"
            )
        effects = BODY_EFFECTS if self.body == "kinematic" else ()
        return Experiment(
            seed=self.seed,
            cohort_size=min(self.robots, cohort),
            body=self.body,
            kinematics=with_overrides(Kinematics(), effects),
            time_scale=self.time_scale,
        )

    def variants(self) -> Sequence[Variant]:
        """See `VariantStudy.variants`: for each board the bounds, and each learner's tracks."""
        if not (self.agent and self.signals and self.board):
            raise InputError("at least one agent, one track and one board are needed")
        for signals in self.signals:
            if signals not in get_args(Signals):
                raise InputError(f"the signals must be one of paper, raw, got {signals!r:.60}")
        found, learners = [], self._learners
        for board in dict.fromkeys(self.board):
            if board not in BOARDS:
                raise InputError(f"the board must be one of {', '.join(BOARDS)}, got {board!r:.60}")
            bounds = tuple(map(recorded_name, (LOWER, UPPER)))
            tasks = self._tasks(board)
            found.append(Variant(f"{board}-bounds", BOARDS[board], tasks, bounds))
            pairs = [*itertools.product(learners, dict.fromkeys(self.signals))]
            if "raw" not in self.signals and "steady" in learners:
                pairs.append(("steady", "raw"))  # where nothing saturates
            rows = [row for pair in pairs if (row := self._row(board, *pair))]
            if not rows:
                raise InputError(
                    f"{', '.join(self.agent)} has no {' or '.join(self.signals)} signals"
                )
            found += rows
        return found

    def _tasks(self, board: BoardName) -> tuple[str, ...]:
        tasks = dataclasses.replace(self.baseline(), **BOARDS[board]).tasks
        return tasks[-1:] if board == "larger" else tasks

    def _row(self, board: BoardName, name: str, track: Signals) -> Variant | None:
        """Returns the run of a learner in a track of a board; None if it has none there."""
        if track == "raw" and name in _PAPER_ALONE:
            return None
        tuned = self._settings  # refuses what cannot be read
        fields, tasks = dict(BOARDS[board]), self._tasks(board)
        proposers = ("creative",)
        if name == "paper":
            proposers = PROPOSERS
        elif name == "steady":
            # Where nothing saturates, both tracks are the same; such runs are named as raw ones.
            start = dataclasses.replace(self.baseline(), **BOARDS[board])
            both = tuple(task for task in tasks if not saturates(start, task))
            if track == "paper":
                tasks = tuple(task for task in tasks if task not in both)
                fields["brain"] = with_overrides(named_brain(name), _SATURATED)
            else:
                tasks = tasks if "raw" in self.signals else both
                fields["brain"] = named_brain(name)
        else:
            settings = tuned.get(name_in_track(name, track), ())
            fields |= {"signals": track, "settings": settings}
            proposers = (name,)
        if not tasks:
            return None
        row = f"{board}-{short_name(name).replace(':', '-')}-{track}"
        return Variant(row, fields, tasks, proposers)

    @functools.cached_property
    def _learners(self) -> tuple[str, ...]:
        """The brains, and the agents as runs record them; their code may run from now on."""
        names = tuple(
            dict.fromkeys(name if name in _BRAINS else recorded_name(name) for name in self.agent)
        )
        for name in names:
            if short_name(name) in (LOWER, UPPER, *PROPOSERS):
                raise InputError(f"{short_name(name)} is no learner of the benchmark")
            if name not in _BRAINS:
                trust(name)
                factory_of(name)
        return names

    @functools.cached_property
    def _settings(self) -> Mapping[str, tuple[str, ...]]:
        """The best settings of each tuned agent of the command, by `name_in_track`."""
        return {
            key: study.best(folder).settings
            for key, (folder, study) in tunings(self.tuned).items()
            if recorded_name(study.agent) in self._learners  # no other agent's code may run
        }

    def folders(self, out: Path) -> Sequence[Path]:
        """See `Study.folders`."""
        return [*super().folders(out), out / FOLDER]

    def check(self, out: Path) -> None:
        """See `VariantStudy.check`; every agent acts once, before anything is written."""
        super().check(out)
        for signals in dict.fromkeys(self.signals) if self.tuned else ():
            for name in self._learners:
                if name in _BRAINS or name in _PAPER_ALONE:
                    continue
                if name_in_track(name, signals) not in self._settings:
                    notice(f"{short_name(name)} was not tuned with {signals} signals: its defaults")
        for name, plan in self.plans().items():
            if not has_all_robots(out / name, plan):
                check_agents(plan)

    def stages(self, out: Path) -> Iterator[Sequence[Job]]:
        """See `Study.stages`: all lives, then what each learner costs."""
        yield from super().stages(out)
        yield cost_jobs(out, self._boards(out))

    def page(self, out: Path) -> Page:
        """See `Study.page`."""
        found = self._boards(out)
        return page(found, measured(out, found), efforts(self.tuned))

    def _boards(self, out: Path) -> dict[Board, list[Entry]]:
        found = boards(read_runs([out / name for name in self.plans()], networks=False))
        return {board: own for board, own in found.items() if board.signals in self.signals}
