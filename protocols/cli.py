"""The command `musebot`: its verbs and their options."""

from __future__ import annotations

import dataclasses
import json
import os
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import tyro

from .errors import InputError
from .exit_status import complain, exit_status
from .options import (
    BODY_CHOICES,
    COHORT_SIZE,
    KINEMATICS,
    PROPOSER_CHOICES,
    TASK_CHOICES,
    Out,
    option,
)
from .simulation.executor_choice import HERE, WorkersOption
from .studies import STUDIES, study_class
from .terminal import safe_streams, say, show_markdown

if TYPE_CHECKING:
    from .experiment.plan import Plan
    from .playback.episode import Episode
    from .playback.viewer import Driver

# Heavy imports (MuJoCo, torch) wait until a verb needs them: help appears at once, and MUJOCO_GL
# can still be chosen.


def _kept(values: str, default: str) -> Any:
    """Returns how help shows an option whose default is the value stored in OUT."""
    return option(values, f"{default}, or the value stored in OUT")


@dataclasses.dataclass
class RunCommand:
    """Simulate robots' lives: all that OUT does not hold yet. Can be stopped and continued.

    Options that are not given keep the values stored in OUT, tasks, proposers and agents included.
    --save-every and the options of the workers are not stored.
    """

    out: Out
    """folder for all files of the run; an unfinished run continues"""
    task: Annotated[tuple[str, ...], option(f"{TASK_CHOICES} ..", "those of the protocol")] = ()
    """tasks to learn"""
    proposer: Annotated[tuple[str, ...], option(f"{PROPOSER_CHOICES} ..", "all three")] = ()
    """how actions are proposed; none of these if only agents are given"""
    agent: Annotated[tuple[str, ...], option("AGENT ..", "none")] = ()
    """q_learner, hand_coded, ppo, or a factory of yours as package.module:factory"""
    trust_agent: bool = False
    """run the code of agents that only OUT names; --agent allows those that it names"""
    robots: Annotated[int | None, _kept("INT", "60")] = None
    """number of robots in each condition"""
    cohort_size: Annotated[int | None, _kept(*COHORT_SIZE)] = None
    """number of robots in lockstep on one random stream; part of the experiment's identity"""
    seed: Annotated[int | None, _kept("INT", "1")] = None
    """seed from which all random streams derive"""
    protocol: Annotated[str | None, _kept("{paper,continual,walls}", "paper")] = None
    """continual: 24 hours of spot finding, the spot moves; walls: spot finding with walls sensed"""
    time_scale: Annotated[float | None, _kept("FLOAT", "1")] = None
    """factor on every duration, in (0, 1], for rehearsals"""
    nose: Annotated[str | None, _kept("{inverse,printed}", "inverse")] = None
    """form of Eq. 3"""
    body: Annotated[str | None, _kept(BODY_CHOICES, "mujoco")] = None
    """mujoco, or kinematic for an ideal differential drive without physics"""
    kinematics: Annotated[tuple[str, ...], _kept(*KINEMATICS)] = ()
    """parameters of the kinematic simulator, such as wall=slides felt=pushed lag=0.08"""
    brain: Annotated[str | None, _kept("{paper,paper-stopping,steady,steady-X}", "paper")] = None
    """paper-stopping: training ends after a minute in the spot; steady-X: steady without X"""
    set: Annotated[tuple[str, ...], _kept("NAME=VALUE ..", "none")] = ()
    """parameters of the brain to change, such as epsilon=0.1 noise=0.5 (`controller.Parameters`)"""
    motor_speed: Annotated[float | None, _kept("FLOAT", "the robot's 0.2")] = None
    """speed of a wheel at motor value 0.5, in metres per second"""
    workers: WorkersOption = HERE
    save_every: float = 60.0
    """seconds between two checkpoints of a cohort"""

    def __call__(self) -> None:
        """Checks all input, then simulates and prints the tables."""
        from .agents.factory import recorded_name, trust
        from .reporting import tables
        from .results.run_files import planned
        from .simulation.runs import simulate
        from .storage import write_text

        if not self.save_every > 0:
            raise InputError(f"save-every must be positive, got {self.save_every}")
        out = self.out.resolve()  # an agent may change the working directory
        plan = self._plan(held := planned(self.out))
        trust(*map(recorded_name, (*self.proposer, *self.agent)))
        if held and self.trust_agent:
            trust(*(condition.proposer for condition in held.conditions))
        run = simulate(out, plan, self.workers.executor(), save_every=self.save_every)
        text = tables.markdown(run)
        write_text(out / "tables.md", f"{text}\n")
        show_markdown(text)

    def _plan(self, held: Plan | None) -> Plan:
        """Returns the plan asked for, completed by what OUT holds or by the defaults."""
        from ..controller import PROPOSERS
        from .agents.factory import recorded_name
        from .experiment.conditions import Condition
        from .experiment.experiment import Experiment
        from .experiment.manifest import check_same_experiment
        from .experiment.plan import Plan, default_cohort_size

        wanted = self._wanted(held)
        if self.robots is not None and self.robots < 1:
            raise InputError(f"robots must be at least 1, got {self.robots}")
        if held:
            experiment = held.experiment
            check_same_experiment(self.out, experiment, wanted)
        else:
            wanted.setdefault("cohort_size", default_cohort_size(self.robots or 60))
            experiment = Experiment(**wanted)
        chosen = (*self.proposer, *map(recorded_name, self.agent))
        if held and not self.task and not chosen:
            return Plan.of(experiment, held.robots, self.robots) if self.robots else held
        tasks = self.task or experiment.tasks
        conditions = [Condition(t, p) for t in tasks for p in chosen or PROPOSERS]
        robots = self.robots or (max(held.robots.values()) if held else 60)
        return Plan.of(experiment, conditions, robots)

    def _wanted(self, held: Plan | None) -> dict[str, Any]:
        """Returns the experiment's fields that were given as options."""
        from ..controller import Parameters
        from ..models import Kinematics
        from .experiment.overrides import named_brain, with_overrides

        settings = (
            "seed", "cohort_size", "protocol", "time_scale", "nose", "body", "motor_speed", "brain"
        )  # fmt: skip
        wanted = {name: x for name in settings if (x := getattr(self, name)) is not None}
        if "brain" in wanted:
            wanted["brain"] = named_brain(wanted["brain"])
        if self.kinematics:
            own = held.experiment.kinematics if held else Kinematics()
            wanted["kinematics"] = with_overrides(own, self.kinematics)
        if self.set:
            own = held.experiment.brain if held else Parameters()
            wanted["brain"] = with_overrides(wanted.get("brain", own), self.set)
        return wanted


@dataclasses.dataclass
class TablesCommand:
    """Print the paper's tables, or another run's, next to those of OUT's robots."""

    out: Out
    """folder of a run"""
    compare: Annotated[Path | None, option("OTHER", "the paper")] = None
    """folder of another run to compare with, cell by cell"""
    json: bool = False
    """print JSON instead of Markdown"""

    def __call__(self) -> None:
        """Reads and prints; changes nothing."""
        from .results.run_files import read_run, run_names

        if self.compare:
            from .analysis.comparison import compare_runs
            from .reporting import comparison_tables as reporting

            names = run_names((self.out, self.compare))
            runs = [read_run(*pair) for pair in zip((self.out, self.compare), names, strict=True)]
            shown: tuple[Any, ...] = (*runs, compare_runs(*runs))
        else:
            from .reporting import tables as reporting

            shown = (read_run(self.out),)
        if self.json:
            print(json.dumps(reporting.as_json(*shown), indent=2))
        else:
            show_markdown(reporting.markdown(*shown))


@dataclasses.dataclass
class FilmCommand:
    """Film a robot: its stored brain in a test, or a policy in an episode."""

    out: Out
    """folder of a run, or a .safetensors file of policies (`musebot study ppo`)"""
    task: Annotated[str, tyro.conf.arg(metavar="TASK")]
    """task of the run, wall_avoidance or spot_finding; or that of the policies (docs/tasks.md)"""
    output: Annotated[Path, tyro.conf.arg(metavar="FILE")]
    """film to write, an .mp4 or a small .gif"""
    proposer: Annotated[str | None, option(PROPOSER_CHOICES, "creative")] = None
    """proposer of the robot; only for a run"""
    robot: int = 0
    """number of the robot within its condition, or of the policy"""
    phase: Literal["pre", "post"] = "post"
    """show the robot before (pre) or after (post) training"""
    seconds: float = 30.0
    """length of the film in seconds"""
    speed: float = 4.0
    """simulated seconds per second of the film"""
    seed: int = 0
    """seed of the brain's noise, or of the start of a policy's episode"""

    def __call__(self) -> None:
        """Renders without a display, through EGL."""
        from .playback import film

        film.film(self._episode(), self.output, seconds=self.seconds, speed=self.speed)
        say(str(self.output))

    def _episode(self) -> Episode:
        from .agents.ppo import Policies
        from .experiment.conditions import Condition
        from .playback.episode import Episode
        from .playback.stored_brains import StoredRobot
        from .results.run_files import read_run

        if not (self.out.is_file() or self.out.suffix == ".safetensors"):
            run = read_run(self.out, replay=True)
            condition = Condition(self.task, self.proposer or "creative")
            return StoredRobot(run, condition, self.robot, self.phase, self.seed).episode()
        if self.proposer:
            raise InputError(f"{self.out} holds policies, which have no proposer")
        policies = Policies.load(self.out, self.task)
        return Episode.of_policy(policies, self.robot, self.phase, self.seed)


@dataclasses.dataclass
class ReportCommand:
    """Write one page about OUT with tables, claims, figures and films: takes a few minutes."""

    out: Out
    """folder of a run; figures are written into its figures/, films into its films/"""
    output: Annotated[Path | None, option("FILE", "report.html in OUT")] = None
    """page to write, an .html"""

    def __call__(self) -> None:
        """Puts a sample of the brains back into robots to measure what they do."""
        from .reporting import report
        from .results.run_files import read_run
        from .simulation.worker import prepare_process

        run = read_run(self.out, replay=True)
        prepare_process()
        say(str(report.report(run, self.out, self.output)))


@dataclasses.dataclass
class ExploreCommand:
    """Open a window on a task, driven at random, by a brain, a policy or the arrow keys."""

    task: Annotated[str, tyro.conf.Positional, tyro.conf.arg(metavar="[TASK]")] = "wall_avoidance"
    """task of docs/tasks.md; with --out only wall_avoidance or spot_finding"""
    out: Annotated[Path | None, option("OUT", "none")] = None
    """folder of a run to take a brain from"""
    policies: Annotated[Path | None, option("FILE", "none")] = None
    """file of PPO's policies for this task, a .safetensors"""
    keys: bool = False
    """drive with the arrow keys"""
    proposer: Annotated[str | None, option(PROPOSER_CHOICES, "creative")] = None
    """proposer of the robot; only for a run"""
    robot: int = 0
    """number of the robot within its condition, or of the policy"""
    phase: Literal["pre", "post"] = "post"
    """show the robot before (pre) or after (post) training"""

    def __call__(self) -> None:
        """Opens the window, which needs a display."""
        from .playback import viewer

        if sum((self.out is not None, self.policies is not None, self.keys)) > 1:
            raise InputError("only one of --out, --policies and --keys can drive")
        if self.proposer and not self.out:
            raise InputError("--proposer needs --out, the run to take a brain from")
        viewer.explore(self.task, self._driver())

    def _driver(self) -> Driver | None:
        """Returns the driver; None for random motor values."""
        from .agents.ppo import Policies
        from .experiment.conditions import Condition
        from .playback.stored_brains import StoredRobot
        from .playback.viewer import ArrowKeys, Driver
        from .results.run_files import read_run

        if self.keys:
            return Driver("arrow keys", ArrowKeys())
        if self.policies:
            return Driver.of_policy(Policies.load(self.policies, self.task), self.robot, self.phase)
        if self.out:
            run = read_run(self.out, replay=True)
            condition = Condition(self.task, self.proposer or "creative")
            return Driver.of_robot(StoredRobot(run, condition, self.robot, self.phase))
        return None


@dataclasses.dataclass
class BenchCommand:
    """Measure the speed compared with the raw physics, on an idle machine: about 7 minutes."""

    json: Annotated[Path | None, option("FILE", "none")] = None
    """file to write all measured numbers to"""
    figure: Annotated[Path | None, option("FILE", "none")] = None
    """file for a figure of the cost against the number of robots, an .svg, .png or .pdf"""
    car_xml: Annotated[Path | None, option("FILE", "looked for where MuJoCo usually is")] = None
    """path of MuJoCo's model/car/car.xml, to time the original car too"""
    quick: bool = False
    """measure next to nothing, to see that everything works"""
    interfaces: bool = False
    """measure the cost of the Gymnasium interfaces instead"""

    def __call__(self) -> None:
        """Prints Markdown, each section as soon as it is measured."""
        from .bench import bench

        bench.run(self.json, self.figure, self.car_xml, self.quick, interfaces=self.interfaces)


@dataclasses.dataclass
class DoctorCommand:
    """Report what is installed, what renders, and what is missing and how to get it."""

    def __call__(self) -> None:
        """Exits with 1 where something is missing."""
        from . import doctor

        raise SystemExit(doctor.report())


@dataclasses.dataclass
class ListStudies:
    """List the studies; `musebot study NAME OUT` runs or continues one."""

    def __call__(self) -> None:
        """Prints a line for each study."""
        width = max(map(len, STUDIES))
        for name, (_, _, line) in STUDIES.items():
            print(f"{name:{width}}  {line}")


def _study_command(name: str) -> type:
    """Returns the command that conducts a study, with the study's fields as options."""
    from .studies.study import conduct

    cls = study_class(name)
    folder = tyro.conf.arg(metavar="OUT", help="folder of the study; an unfinished one continues")

    def call(self: Any) -> None:
        page = conduct(self.study, self.out, self.workers.executor())
        show_markdown(page.markdown)

    command = dataclasses.make_dataclass(
        "StudyCommand",
        [
            ("out", Annotated[Path, tyro.conf.Positional, folder]),
            ("study", Annotated[cls, tyro.conf.arg(name="")]),
            ("workers", WorkersOption, HERE),
        ],
        namespace={"__call__": call},
    )
    command.__doc__ = cls.__doc__
    return command


VERBS: dict[str, type] = {
    "run": RunCommand,
    "tables": TablesCommand,
    "film": FilmCommand,
    "report": ReportCommand,
    "study": ListStudies,
    "explore": ExploreCommand,
    "bench": BenchCommand,
    "doctor": DoctorCommand,
}


def main(arguments: Sequence[str] | None = None) -> int:
    """Runs the command.

    Args:
      arguments: Words of the command line; None for those of this process.

    Returns:
      The exit status: 0, 1 for a failure, 2 for bad input, 130 for Ctrl-C, 141 for a closed pipe.
    """
    safe_streams()
    words = [*(sys.argv[1:] if arguments is None else arguments)]
    given = [word.partition("=")[0] for word in words if word.startswith("--")]
    for name in given:
        if given.count(name) > 1:  # tyro would use the last one only
            return complain(f"{name} is given twice: give it once, followed by all its values", 2)
    verb: Any = None

    def parse() -> None:
        nonlocal verb
        verb = _parse(words)

    if status := exit_status(parse, check=False):  # a reader of help may close the pipe early
        return status
    # Before the first import of mujoco: a film opens EGL itself, the other verbs draw nothing.
    if not isinstance(verb, ExploreCommand):
        os.environ["MUJOCO_GL"] = "off"
    unchecked = DoctorCommand, ListStudies  # one checks the versions itself, the other needs none
    return exit_status(verb, check=not isinstance(verb, unchecked))


def _parse(words: list[str]) -> Any:
    config = (tyro.conf.FlagCreatePairsOff,)
    if words[:1] == ["study"] and len(words) > 1 and not words[1].startswith("-"):
        name = words[1]
        if name not in STUDIES:
            raise InputError(f"the study must be one of {', '.join(STUDIES)}, got {name!r}")
        os.environ.setdefault("MUJOCO_GL", "off")
        command = _study_command(name)
        return tyro.cli(command, args=words[2:], prog=f"musebot study {name}", config=config)
    return tyro.extras.subcommand_cli_from_dict(
        VERBS,
        args=words,
        prog="musebot",
        description="Creative robots that learn during their lives, in MuJoCo.",
        config=config,
    )
