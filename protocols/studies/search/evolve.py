"""The study that evolves parameters: CMA-ES over generations of brains, whole lives as fitness.

N. Hansen and A. Ostermeier, "Completely Derandomized Self-Adaptation in Evolution Strategies",
Evolutionary Computation 9(2), 2001. The search is that of the package `cmaes`, because it is small,
needs NumPy only, and proposes the same brains again when its generations are told again.
"""

from __future__ import annotations

import dataclasses
import functools
import importlib.util
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, ClassVar

import numpy as np

from ....controller import Parameters
from ....models import Kinematics
from ...errors import InputError
from ...experiment.budget import check_memory
from ...experiment.conditions import Condition
from ...experiment.experiment import Experiment
from ...experiment.overrides import named_brain, overrides_of, with_overrides
from ...experiment.plan import Plan
from ...experiment.schedules import Schedule
from ...shared_options import BODY_EFFECTS, BodyKinematicsOption, option
from ...simulation.jobs import Job
from ...terminal import notice
from ..study import Page, Study, check_positive
from . import evolve_page as pages
from .evaluation import EvaluationJob
from .evolve_page import Evolution, Generation
from .space import RANGES, brain_at, check_names, point_of

if TYPE_CHECKING:
    from cmaes import CMA

FOLDER = "evaluations"
_SIGMA = 0.2  # initial standard deviation of every coordinate
_FEWEST = 4  # brains in a generation, as CMA-ES needs
_FINALS = 4  # cohorts of a brain in the end, on seeds that no generation had


@dataclasses.dataclass
class Evolve(Study):
    """Evolve parameters of a brain in the kinematic simulator.

    All brains of a generation are simulated with the same seeds, each generation with new ones. The
    winner is the mean of the search distribution after the last generation. It, the best brain of
    that generation and the brain from which the search started are then simulated with fresh seeds.
    """

    name: ClassVar[str] = "evolve"
    shows_finished: ClassVar[bool] = True

    brain: str = "steady"
    """brain from which the search starts"""
    set: Annotated[tuple[str, ...], option("NAME=VALUE ..", "none")] = ()
    """parameters of that brain to change first, such as td_error_limit=0.03"""
    over: Annotated[
        tuple[str, ...], option(f"{{{','.join(RANGES)}}} ..", "six of `steady`'s")
    ] = (
        "learn_rate",
        "initial_learn_rate",
        "noise",
        "random_share",
        "epsilon",
        "advantage_scale",
    )  # fmt: skip
    """parameters to evolve, separated by spaces or commas"""
    budget: int = 200
    """number of brains to evaluate, rounded down to whole generations; may be increased later"""
    generation: int = 10
    """number of brains in a generation"""
    robots: int = 50
    """number of robots with each brain"""
    task: str = "spot_finding"
    """task of the robots; more time in the spot, or less in contact, is better"""
    protocol: str = "paper"
    """protocol of the lives, as in `musebot run`"""
    time_scale: float = 0.25
    """factor on every duration, in (0, 1]"""
    kinematics: BodyKinematicsOption = BODY_EFFECTS
    """parameters of the kinematic simulator"""
    seed: int = 1
    """seed of the search and of the first generation's robots; each generation has the next one"""

    def __post_init__(self) -> None:
        """Splits names that are separated by commas."""
        self.over = tuple(name for word in self.over for name in word.split(","))

    @functools.cached_property
    def start(self) -> Experiment:
        """The experiment of the brain from which the search starts.

        Raises:
          InputError: an option is invalid.
        """
        check_positive(budget=self.budget, generation=self.generation, robots=self.robots)
        if self.generation < _FEWEST:
            raise InputError(f"a generation needs at least {_FEWEST} brains, got {self.generation}")
        if self.budget < self.generation:
            raise InputError(
                f"the budget must be at least one generation of {self.generation} brains, "
                f"got {self.budget}"
            )
        brain = with_overrides(named_brain(self.brain), self.set)
        check_names(self.over, brain)
        protocol: Any = self.protocol
        experiment = Experiment(
            seed=self.seed,
            cohort_size=self.robots,
            time_scale=self.time_scale,
            body="kinematic",
            kinematics=with_overrides(Kinematics(), self.kinematics),
            brain=brain,
            protocol=protocol,
        )
        if self.task not in experiment.tasks:
            names = ", ".join(experiment.tasks)
            raise InputError(f"the task must be one of {names}, got {self.task!r}")
        if self.seed + self.generations + _FINALS >= 2**32:
            raise InputError(f"the seed must be below 2^32 minus the generations, got {self.seed}")
        return experiment

    @property
    def generations(self) -> int:
        """Number of generations."""
        return self.budget // self.generation

    def experiments(self) -> Mapping[str, Experiment]:
        """See `Study.experiments`."""
        if importlib.util.find_spec("cmaes") is None:
            raise InputError("the search needs cmaes: pip install 'musebot[evolve]'")
        return {"start": self.start}

    def details(self) -> Mapping[str, Any]:
        """See `Study.details`; the budget may be increased later."""
        ranges = {name: dataclasses.asdict(RANGES[name]) for name in self.over}
        return {"over": ranges, "generation": self.generation, "task": self.task}

    def folders(self, out: Path) -> Sequence[Path]:
        """See `Study.folders`."""
        return [out / FOLDER]

    def check(self, out: Path) -> None:
        """See `Study.check`: reads all evaluations."""
        check_memory(Plan.of(self.start, [self._condition], self.robots))
        self.evolution(out)

    def stages(self, out: Path) -> Iterator[Sequence[Job]]:
        """See `Study.stages`: a group for each generation, then the tests on fresh seeds."""
        evolution = Evolution(self.over)
        for jobs in self._course(out, evolution):
            number = len(evolution.generations)
            if number < self.generations and not all(job.done() for job in jobs):
                best = evolution.best
                so_far = "" if best is None else f", best so far {abs(best[1]):.3f} ({best[0]})"
                notice(f"evolve: generation {number + 1} of {self.generations}{so_far}")
            yield jobs

    def evolution(self, out: Path) -> Evolution:
        """Reads the finished generations, and the final tests if they are finished."""
        evolution = Evolution(self.over)
        for jobs in self._course(out, evolution):
            if not all(job.done() for job in jobs):
                break
        return evolution

    def _course(self, out: Path, evolution: Evolution) -> Iterator[list[EvaluationJob]]:
        """Yields each generation's jobs, then those of the tests on fresh seeds.

        The jobs must be done when the next group is requested: what they found is added to the
        evolution, and the search moves.
        """
        search = self._search()
        for number in range(self.generations):
            points, jobs = self._generation(search, number, out)
            yield jobs
            self._tell(evolution, search, points, jobs)
        winner, last = self._brain(search.mean), evolution.generations[-1]
        brains = {
            "start": self.start.brain,
            "winner": winner,
            "best": self._brain(last.points[last.fitness.argmax()]),
        }
        tests = {name: self._finals(out, name, brain) for name, brain in brains.items()}
        yield [*dict.fromkeys(job for jobs in tests.values() for job in jobs)]
        evolution.tests = {
            name: np.concatenate([job.shares() for job in jobs]) for name, jobs in tests.items()
        }
        evolution.words = self.options_of(winner)

    def options_of(self, brain: Parameters) -> str:
        """Returns the options of `musebot run` that choose a brain and its lives."""
        changes = overrides_of(brain, named_brain(self.brain))
        words = [f"--task {self.task}", "--proposer creative", f"--brain {self.brain}"]
        words += ["--set", *changes] if changes else []
        words += [f"--protocol {self.protocol}"] if self.protocol != "paper" else []
        return " ".join(words)

    def page(self, out: Path) -> Page:
        """See `Study.page`."""
        return pages.page(self.evolution(out), self.start, self._condition, self._schedule)

    @property
    def _schedule(self) -> Schedule:
        return self.start.schedule(self.task)

    @property
    def _condition(self) -> Condition:
        return Condition(self.task, "creative")

    def _search(self) -> CMA:
        from cmaes import CMA

        return CMA(
            mean=point_of(self.start.brain, self.over),
            sigma=_SIGMA,
            bounds=np.tile([0.0, 1.0], (len(self.over), 1)),
            seed=self.seed,
            population_size=self.generation,
        )

    def _generation(
        self, search: CMA, number: int, out: Path
    ) -> tuple[list[np.ndarray], list[EvaluationJob]]:
        points = [search.ask() for _ in range(self.generation)]
        jobs = [
            self._job(
                out,
                f"{number:03}-{index:02}",
                self._brain(point),
                self.seed + number,
            )
            for index, point in enumerate(points)
        ]
        return points, jobs

    def _finals(self, out: Path, name: str, brain: Parameters) -> list[EvaluationJob]:
        name = "start" if brain == self.start.brain else name
        first = self.seed + self.generations
        return [
            self._job(out, f"final-{self.generations:03}-{name}-{k}", brain, first + k)
            for k in range(_FINALS)
        ]

    def _job(self, out: Path, name: str, brain: Parameters, seed: int) -> EvaluationJob:
        experiment = dataclasses.replace(self.start, brain=brain, seed=seed)
        path = out / FOLDER / f"{name}.safetensors"
        return EvaluationJob(path, experiment, self._condition)

    def _tell(
        self,
        evolution: Evolution,
        search: CMA,
        points: Sequence[np.ndarray],
        jobs: Sequence[EvaluationJob],
    ) -> None:
        """Adds a generation to the evolution and lets the search move."""
        shares = np.array([job.shares().mean() for job in jobs])
        sign = 1 if self._schedule.wanted else -1
        search.tell([(x, -sign * float(y)) for x, y in zip(points, shares, strict=True)])
        evolution.generations.append(
            Generation(np.array(points), sign * shares, search.mean.copy())
        )

    def _brain(self, point: np.ndarray) -> Parameters:
        return brain_at(point, self.over, self.start.brain)
