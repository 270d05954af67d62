"""The command `musebot`: its verbs, their options, and one sentence for what is wrong."""

from __future__ import annotations

import dataclasses
import json
import os
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import tyro

from .errors import InputError, complain, exit_status
from .options import (
    BODIES_TOLD,
    COHORT_SIZE,
    HERE,
    KINEMATICS,
    PROPOSERS_TOLD,
    TASKS_TOLD,
    Out,
    WorkersTold,
    option,
)

if TYPE_CHECKING:
    from .experiment.experiment import Experiment, Plan
    from .playback.episode import Episode
    from .playback.viewer import Driver
    from .results.results import Results

# Heavy imports (MuJoCo, torch) wait until a verb needs them: help is at once, and MUJOCO_GL
# can still be chosen.


def _kept(values: str, default: str) -> Any:
    """How help shows an option that an OUT begun before answers by itself."""
    return option(values, f"{default}, or OUT's own")


@dataclasses.dataclass
class Run:
    """Live lives: all that OUT does not hold yet, resumable at any moment.

    An OUT that was begun knows what it is: what is not told stays as it was, and so do its tasks,
    proposers and agents where none of these is told. How it is lived, from --save-every on, is told
    anew.
    """

    out: Out
    """folder for everything the run leaves; an unfinished one goes on"""
    task: Annotated[tuple[str, ...], option(f"{TASKS_TOLD} ..", "the course's")] = ()
    """what has to be learnt"""
    proposer: Annotated[tuple[str, ...], option(f"{PROPOSERS_TOLD} ..", "all three")] = ()
    """who proposes actions; nobody of these if only agents are named"""
    agent: Annotated[tuple[str, ...], option("FACTORY ..", "none")] = ()
    """package.module:factory: agents of yours, beside the proposers or instead of them"""
    robots: Annotated[int | None, _kept("INT", "60")] = None
    """robots in each condition"""
    cohort_size: Annotated[int | None, _kept(*COHORT_SIZE)] = None
    """robots in lockstep on one random stream; part of the experiment's identity"""
    seed: Annotated[int | None, _kept("INT", "1")] = None
    """of every random stream"""
    course: Annotated[str | None, _kept("{paper,day,walls}", "paper")] = None
    """spot finding in day: 24 hours, the spot jumps; in walls: they are felt, contact earns 0"""
    time_scale: Annotated[float | None, _kept("FLOAT", "1")] = None
    """below 1 shortens every duration, for rehearsals"""
    nose: Annotated[str | None, _kept("{inverse,printed}", "inverse")] = None
    """the form of Eq. 3"""
    body: Annotated[str | None, _kept(BODIES_TOLD, "mujoco")] = None
    """kinematic: an ideal differential drive instead of physics"""
    kinematics: Annotated[tuple[str, ...], _kept(*KINEMATICS)] = ()
    """of the stand-in, such as wall=slides felt=pushed lag=0.08 (docs/results.md has all)"""
    brain: Annotated[str | None, _kept("{paper,paper-content,steady,steady-X}", "paper")] = None
    """paper-content: until a minute in the spot; steady: ours; steady-X: without X (cap, gap ..)"""
    but: Annotated[tuple[str, ...], _kept("NAME=VALUE ..", "none")] = ()
    """numbers of the brain to change, such as epsilon=0.1 noise=0.5 (`controller.Parameters`)"""
    motor_speed: Annotated[float | None, _kept("FLOAT", "the robot's 0.2")] = None
    """of a wheel at full motor, in metres a second"""
    workers: WorkersTold = HERE
    save_every: float = 60.0
    """seconds between two checkpoints of a cohort"""

    def __call__(self) -> None:
        """Checks everything, then lives."""
        from .reporting import tables
        from .simulation import engine
        from .simulation.cohort import check_births
        from .storage import write_atomically

        if not self.save_every > 0:
            raise InputError(f"save-every must be positive, got {self.save_every}")
        plan = self._plan(engine.open_directory(self.out))
        check_births(plan)
        results = engine.run(self.out, plan, self.workers.workforce(), save_every=self.save_every)
        text = tables.markdown(plan.experiment, results)
        write_atomically(self.out / "tables.md", f"{text}\n".encode())
        _print(text)

    def _plan(self, held: Plan | None) -> Plan:
        """What was asked for; for what was not, what OUT holds, or the defaults."""
        from .experiment.experiment import (
            PROPOSERS,
            Experiment,
            Kinematics,
            Parameters,
            Plan,
            brief,
            default_cohort_size,
            named_brain,
            told,
        )

        settings = (
            "seed", "cohort_size", "course", "time_scale", "nose", "body", "motor_speed", "brain"
        )  # fmt: skip
        asked = {name: x for name in settings if (x := getattr(self, name)) is not None}
        if "brain" in asked:
            asked["brain"] = named_brain(asked["brain"])
        if self.kinematics:
            own = held.experiment.kinematics if held else Kinematics()
            asked["kinematics"] = told(own, self.kinematics)
        if self.but:
            own = held.experiment.brain if held else Parameters()
            asked["brain"] = told(asked.get("brain", own), self.but)
        if self.robots is not None and self.robots < 1:
            raise InputError(f"the number of robots must be at least 1, got {self.robots}")
        if held:
            experiment = held.experiment
            for name, value in asked.items():
                if value != (own := getattr(experiment, name)):
                    if name == "brain":
                        named = [self.brain, *self.but]
                        own, value = experiment.brain_name, " ".join(filter(None, named))
                    if name == "kinematics":
                        own, value = brief(experiment.kinematics), " ".join(self.kinematics)
                    raise InputError(
                        f"{self.out} holds an experiment with {name} {own}, not {value}"
                    )
        else:
            asked.setdefault("cohort_size", default_cohort_size(self.robots or 60))
            experiment = Experiment(**asked)
        chosen = (*self.proposer, *self.agent)
        if held and not self.task and not chosen:
            return Plan.of(experiment, held.robots, self.robots) if self.robots else held
        conditions = [(t, p) for t in self.task or experiment.tasks for p in chosen or PROPOSERS]
        robots = self.robots or (max(held.robots.values()) if held else 60)
        return Plan.of(experiment, conditions, robots)


@dataclasses.dataclass
class Tables:
    """Print the paper's tables, or another run's, beside ours, from OUT's robots."""

    out: Out
    """folder of a run"""
    beside: Annotated[Path | None, option("OTHER", "the paper")] = None
    """folder of another run to compare OUT's with, cell by cell"""
    json: bool = False
    """as JSON instead of Markdown"""

    def __call__(self) -> None:
        """Reads and prints; changes nothing."""
        from .analysis import comparison as beside
        from .reporting import tables

        if self.beside:
            outs = self.out, self.beside
            named = zip(beside.names_of(outs), outs, strict=True)
            sides = [beside.Side(name, *_read(out)) for name, out in named]
            shown, lives = beside, (*sides, beside.all_cells(*sides))
        else:
            shown, lives = tables, _read(self.out)
        if self.json:
            print(json.dumps(shown.as_json(*lives), indent=2))
        else:
            _print(shown.markdown(*lives))


@dataclasses.dataclass
class Film:
    """Film a robot: its stored brain sits a test again, or its policy lives an episode."""

    out: Out
    """folder of a run, or a .safetensors of policies (`python -m musebot.protocols.ppo`)"""
    task: Annotated[str, tyro.conf.arg(metavar="TASK")]
    """of the run, wall_avoidance or spot_finding; or that of the policies, any (docs/tasks.md)"""
    output: Annotated[Path, tyro.conf.arg(metavar="FILE")]
    """the film, an .mp4 or a small .gif"""
    proposer: Annotated[str | None, option(PROPOSERS_TOLD, "creative")] = None
    """whose brain, of a run"""
    robot: int = 0
    """number of the robot within its condition, or of the policy"""
    phase: Literal["pre", "post"] = "post"
    """before or after training"""
    seconds: float = 30.0
    """length of the film, in seconds of the viewer's time"""
    speed: float = 4.0
    """simulated seconds in a second of the film"""
    seed: int = 0
    """of the noise in the brain, or of where a policy's episode starts"""

    def __call__(self) -> None:
        """Renders headless, through EGL."""
        from .playback import film

        film.film(self._episode(), self.output, seconds=self.seconds, speed=self.speed)
        print(self.output)

    def _episode(self) -> Episode:
        from .agents.ppo import Policies
        from .playback.episode import Episode
        from .playback.stored_brains import Candidate

        if not (self.out.is_file() or self.out.suffix == ".safetensors"):
            run = _read(self.out, enact=True)
            who = self.proposer or "creative", self.robot, self.phase, self.seed
            return Candidate(*run, self.task, *who).episode()
        if self.proposer:
            raise InputError(f"{self.out} holds policies, and only brains have a proposer")
        policies = Policies.load(self.out, self.task)
        return Episode.of_policy(policies, self.robot, self.phase, self.seed)


@dataclasses.dataclass
class Report:
    """Write one page about OUT: tables, claims, figures and films, all inside it: a few minutes."""

    out: Out
    """folder of a run; figures go into its figures/, films into its films/"""
    output: Annotated[Path | None, option("FILE", "report.html in OUT")] = None
    """the page, an .html"""

    def __call__(self) -> None:
        """Puts a sample of the brains back into their robots, to see what they do."""
        from .reporting import report
        from .simulation.local import prepare_process

        experiment, results = _read(self.out, enact=True)
        prepare_process()
        print(report.report(experiment, results, self.out, self.output))


@dataclasses.dataclass
class Explore:
    """Open a window on a task: random motors drive, or a brain, a policy, or the arrow keys."""

    task: Annotated[str, tyro.conf.Positional, tyro.conf.arg(metavar="[TASK]")] = "wall_avoidance"
    """any of docs/tasks.md; a run's robots know wall_avoidance or spot_finding"""
    out: Annotated[Path | None, option("OUT", "none")] = None
    """folder of a run to take a brain from"""
    policies: Annotated[Path | None, option("FILE", "none")] = None
    """policies of PPO's for this task, a .safetensors, to take one from"""
    keys: bool = False
    """drive with the arrow keys"""
    proposer: Annotated[str | None, option(PROPOSERS_TOLD, "creative")] = None
    """whose brain, of a run"""
    robot: int = 0
    """number of the robot within its condition, or of the policy"""
    phase: Literal["pre", "post"] = "post"
    """the brain or the policy before or after training"""

    def __call__(self) -> None:
        """Needs a display."""
        from .playback import viewer as explore

        if sum((self.out is not None, self.policies is not None, self.keys)) > 1:
            raise InputError("only one can drive: a brain of OUT, one of the policies, or the keys")
        if self.proposer and not self.out:
            raise InputError("only brains have a proposer: name the run to take one from by --out")
        explore.explore(self.task, self._driver())

    def _driver(self) -> Driver | None:
        """Who drives; None for random motors."""
        from .agents.ppo import Policies
        from .playback.stored_brains import Candidate
        from .playback.viewer import ArrowKeys, Driver

        if self.keys:
            return Driver("arrow keys", ArrowKeys())
        if self.policies:
            return Driver.of_policy(Policies.load(self.policies, self.task), self.robot, self.phase)
        if self.out:
            run = _read(self.out, enact=True)
            who = self.proposer or "creative", self.robot, self.phase
            return Driver.of_candidate(Candidate(*run, self.task, *who))
        return None


@dataclasses.dataclass
class Bench:
    """Measure the speed against the raw physics, on an idle machine: about 7 minutes."""

    json: Annotated[Path | None, option("FILE", "none")] = None
    """keep every number in this file"""
    figure: Annotated[Path | None, option("FILE", "none")] = None
    """draw the cost against the number of robots, an .svg, .png or .pdf"""
    car_xml: Annotated[Path | None, option("FILE", "looked for where MuJoCo usually is")] = None
    """MuJoCo's own model/car/car.xml"""
    quick: bool = False
    """measure next to nothing, to see that everything works"""

    def __call__(self) -> None:
        """Prints Markdown, a section as soon as it is known."""
        from ..models import check_versions

        check_versions()
        from .bench import bench

        bench.run(self.json, self.figure, self.car_xml, self.quick)


@dataclasses.dataclass
class Doctor:
    """Say what is installed, what renders, and what is missing and how to get it."""

    def __call__(self) -> None:
        """Exits 1 where something is missing."""
        from . import doctor

        raise SystemExit(doctor.report())


def _read(out: Path, *, enact: bool = False) -> tuple[Experiment, Results]:
    from .simulation import engine

    return engine.read_run(out, enact=enact)


def _print(text: str) -> None:
    from rich.console import Console
    from rich.markdown import Markdown

    console = Console()
    if console.is_terminal:
        console.print(Markdown(text))
    else:
        print(text)


def main(arguments: list[str] | None = None) -> int:
    """Runs a verb.

    Returns:
      The exit status: 0, 1 for a failure, 2 for bad input, 130 for Ctrl-C, 141 where whoever
      reads closed the pipe.
    """
    words = sys.argv[1:] if arguments is None else arguments
    told = [word.partition("=")[0] for word in words if word.startswith("--")]
    for name in told:
        if told.count(name) > 1:  # tyro would forget all but the last
            return complain(f"{name} is given twice: once, with all its values after it", 2)
    verb: Any = None

    def parse() -> None:
        nonlocal verb
        verb = tyro.extras.subcommand_cli_from_dict(
            {
                "run": Run,
                "tables": Tables,
                "film": Film,
                "report": Report,
                "explore": Explore,
                "bench": Bench,
                "doctor": Doctor,
            },
            args=arguments,
            prog="musebot",
            description="Creative robots that learn during their life, in MuJoCo.",
            config=(tyro.conf.FlagCreatePairsOff,),
        )

    if status := exit_status(parse, check=False):  # who asks for help may read no further
        return status
    # Before the first import of mujoco: a film opens EGL itself, the rest draws nothing at all.
    if not isinstance(verb, Explore):
        os.environ["MUJOCO_GL"] = "off"
    return exit_status(verb, check=not isinstance(verb, Doctor))  # who says himself what is wrong
