"""`musebot run`: simulates robots."""

from __future__ import annotations

import dataclasses
import itertools
import json
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

from ..errors import InputError
from ..lives.executor_choice import HERE, Workers, WorkersOption
from ..terminal import show_markdown
from .shared_options import (
    BODY_CHOICES,
    COHORT_SIZE,
    KINEMATICS,
    PROPOSER_CHOICES,
    TASK_CHOICES,
    Out,
    option,
)

if TYPE_CHECKING:
    from ..lives.conditions import Condition
    from ..lives.config import Config
    from ..lives.plan import Plan
    from ..lives.run import Run

_FIELDS = (
    "seed", "cohort_size", "protocol", "time_scale", "nose", "nose_place", "body", "physics",
    "device", "signals", "arena_scale", "motor_speed", "motor_torque", "brain",
)  # fmt: skip


def _kept(values: str, default: str) -> Any:
    """Returns how help shows an option whose default is the value stored in OUT."""
    return option(values, f"{default}, or the value stored in OUT")


@dataclasses.dataclass
class RunCommand:
    """Simulate the robots that are missing in OUT. Can be stopped and continued.

    Options that are not given keep the values stored in OUT, also tasks, proposers and agents. Not
    stored are --save-every, --log, --processes, --engine and --address. If --config plans robots,
    --task, --proposer and --agent choose among these. Where standard error is a file, lines show
    the progress, at most a minute apart.
    """

    out: Out
    """folder for all files of the run; an unfinished run continues"""
    task: Annotated[tuple[str, ...], _kept(f"{TASK_CHOICES} ..", "those of the protocol")] = ()
    """tasks to learn"""
    proposer: Annotated[tuple[str, ...], _kept(f"{PROPOSER_CHOICES} ..", "all three")] = ()
    """how actions are proposed; none of these if only agents are given"""
    agent: Annotated[tuple[str, ...], _kept("AGENT ..", "none")] = ()
    """names that `musebot list agents` prints, or a factory of yours as package.module:factory"""
    agent_set: Annotated[tuple[str, ...], _kept("NAME=VALUE ..", "none")] = ()
    """settings of the agents to change, such as discount=0.95"""
    signals: Annotated[str | None, _kept("{paper,raw}", "paper")] = None
    """what agents sense; raw: smell and reward before they saturate, as steady reads them"""
    trust_agent: bool = False
    """also run the code of agents that are named in OUT or --config, but not in --agent"""
    robots: Annotated[int | None, _kept("INT", "60")] = None
    """number of robots in each condition"""
    cohort_size: Annotated[int | None, _kept(*COHORT_SIZE)] = None
    """number of robots in lockstep on one random stream; part of the experiment's identity"""
    seed: Annotated[int | None, _kept("INT", "1")] = None
    """seed from which all random streams derive"""
    protocol: Annotated[str | None, _kept("{paper,walls}", "paper")] = None
    """walls: spot finding with walls sensed"""
    time_scale: Annotated[float | None, _kept("FLOAT", "1")] = None
    """factor on every duration, in (0, 1], for rehearsals"""
    reading: Annotated[str | None, _kept("{body,plain}", "body")] = None
    """reading of the paper: sets --body, --kinematics, --nose, --nose-place where not given"""
    nose: Annotated[str | None, _kept("{inverse,printed}", "inverse")] = None
    """form of Eq. 3"""
    nose_place: Annotated[str | None, _kept("{front,centre}", "front")] = None
    """place of the nose: front of the rim, or centre of the robot"""
    body: Annotated[str | None, _kept(BODY_CHOICES, "mujoco")] = None
    """mujoco, or kinematic for an ideal differential drive without physics"""
    physics: Annotated[str | None, _kept("{c,warp}", "c")] = None
    """engine of --body mujoco; c: MuJoCo; warp: MuJoCo Warp, in single precision, also on a GPU"""
    device: Annotated[str | None, _kept("{cpu,cuda,cuda:N}", "cpu")] = None
    """device of kinematic robots or MuJoCo Warp, and of brains; on a GPU, take large cohorts"""
    kinematics: Annotated[tuple[str, ...], _kept(*KINEMATICS)] = ()
    """parameters of the kinematic simulator, such as wall=slides felt=pushed lag=0.08"""
    brain: Annotated[
        str | None, _kept("{paper,recurrent,steady,steady-X}", "paper")
    ] = None
    """a name that `musebot list brains` explains; steady-X: steady without its ingredient X"""
    set: Annotated[tuple[str, ...], _kept("NAME=VALUE ..", "none")] = ()
    """parameters of the brain to change, such as epsilon=0.1 noise=0.5 (`controller.Parameters`)"""
    arena_scale: Annotated[float | None, _kept("FLOAT", "1")] = None
    """factor of the arena's length and width, at least 1"""
    motor_speed: Annotated[float | None, _kept("FLOAT", "the robot's 0.2")] = None
    """speed of a wheel at motor value 0.5, in metres per second"""
    motor_torque: Annotated[str | None, _kept("{constant,scaled}", "constant")] = None
    """torque at another --motor-speed; scaled: with the speed, so that wheels keep their lag"""
    workers: WorkersOption = HERE
    save_every: float = 60.0
    """seconds between two checkpoints of a cohort"""
    config: Annotated[Path | None, option("FILE", "none")] = None
    """YAML file, or experiment.json of a run, with values of the options that are not given"""
    log: Literal["none", "tensorboard"] = "none"
    """tensorboard: also write the mean curve of each condition, in OUT/tensorboard"""

    def __call__(self) -> None:
        """Simulates, and prints the tables."""
        from ..lives.run_files import TABLES_FILE
        from ..pages import tables
        from ..storage import resolved, write_text

        out = resolved(self.out)  # an agent may change the working directory
        text = tables.markdown(self.simulate())
        write_text(out / TABLES_FILE, f"{text}\n")
        show_markdown(text)

    def simulate(self, *, quiet: bool = False) -> Run:
        """Checks all input, then simulates.

        Args:
          quiet: Whether to show no progress.

        Returns:
          The run with all robots of OUT.

        Raises:
          InputError: a value is invalid, or OUT holds something else; nothing was done.
          Interrupted, RunError, OSError: see `simulation.runs.simulate`.
        """
        from ..agents.names import recorded_name
        from ..agents.trust import trust
        from ..lives.config import Config, read_config
        from ..lives.run_files import planned
        from ..lives.runs import simulate
        from ..lives.tensorboard_log import check_tensorboard

        if self.log not in (logs := ("none", "tensorboard")):
            raise InputError(f"log must be one of {', '.join(logs)}, got {self.log!r}")
        if log := self.log == "tensorboard":
            check_tensorboard()
        if not self.save_every > 0:
            raise InputError(f"save-every must be positive, got {self.save_every}")
        config = read_config(self.config) if self.config else Config()
        held = planned(self.out)
        trust(*self.proposer, *map(recorded_name, self.agent))
        if self.trust_agent:
            trust(*(condition.proposer for condition in self._file_robots(config)))
            trust(*(condition.proposer for condition in held.robots) if held else ())
        plan = self._plan(held, config)
        changed = plan.experiment.signals == "raw" or plan.experiment.settings
        if changed and not held and all(condition.has_brain for condition in plan.robots):
            raise InputError(
                "settings and raw signals change agents only, and this run has none; a brain is "
                "changed with --set, for example --set raw_signals=true"
            )
        executor = self.workers.executor(plan.experiment.device)
        return simulate(self.out, plan, executor, save_every=self.save_every, quiet=quiet, log=log)

    def _plan(self, held: Plan | None, config: Config) -> Plan:
        """Returns the plan asked for, completed by the file, by OUT, and by the defaults."""
        from ...controller import PROPOSERS
        from ..agents.names import recorded_name
        from ..agents.trust import check_trusted
        from ..lives.conditions import Condition
        from ..lives.experiment import Experiment
        from ..lives.manifest import check_same_experiment
        from ..lives.plan import Plan, default_cohort_size

        wanted = self._wanted(held, config)
        if self.robots is not None and (type(self.robots) is not int or self.robots < 1):
            raise InputError(f"robots must be at least 1, got {self.robots}")
        chosen = (*self.proposer, *map(recorded_name, self.agent))
        rows = self._file_robots(config)
        whole = ", ".join(map(str, rows))
        for condition in [*rows]:
            if self.robots is not None:
                rows[condition] = self.robots
            tasks, proposers = self.task or (condition.task,), chosen or (condition.proposer,)
            if condition.task not in tasks or condition.proposer not in proposers:
                del rows[condition]
        found = {name for condition in rows for name in (condition.task, condition.proposer)}
        if whole and not {*self.task, *chosen} <= found:
            raise InputError(
                f"{self.config} plans {whole}: --task, --proposer and --agent choose among these, "
                f"got {', '.join((*self.task, *chosen))}"
            )
        for condition in rows:
            check_trusted(condition.proposer, self.config)
        known = rows or (held.robots if held else {})
        robots = max(known.values(), default=60) if self.robots is None else self.robots
        if held:
            experiment = held.experiment
            check_same_experiment(self.out, experiment, wanted)
        else:
            if "cohort_size" not in wanted:
                wanted["cohort_size"] = default_cohort_size(*(rows.values() or [robots]))
            experiment = Experiment(**wanted)
        if rows:
            return Plan(experiment, rows)
        if held and not self.task and not chosen:
            return Plan.of(experiment, held.robots, robots) if self.robots else held
        here = list(held.robots) if held else []
        pairs = itertools.product(
            self.task or dict.fromkeys(c.task for c in here) or experiment.tasks,
            chosen or dict.fromkeys(c.proposer for c in here) or PROPOSERS,
        )
        conditions = [Condition(*pair) for pair in pairs]
        if not (self.task and chosen):
            conditions = [c for c in conditions if c in here] or conditions
        return Plan.of(experiment, conditions, robots)

    def _file_robots(self, config: Config) -> dict[Condition, int]:
        """Returns the robots that the file plans."""
        from ..agents.names import recorded_name
        from ..lives.conditions import Condition

        try:
            rows: dict[Condition, int] = {}
            for (task, proposer), number in config.robots.items():
                condition = Condition(task, recorded_name(proposer))
                if condition in rows:  # an agent has several names
                    raise InputError(f"{condition} is planned twice")
                rows[condition] = number
            return rows
        except InputError as error:
            raise InputError(f"{self.config}: {error}") from error

    def _wanted(self, held: Plan | None, config: Config) -> dict[str, Any]:
        """Returns the experiment's fields that were given as options, or else in the file."""
        from ...controller import Parameters
        from ...models import Kinematics
        from ..agents.settings import settings_from
        from ..lives.overrides import named_brain, named_reading, with_overrides

        wanted = dict(config.fields)
        if self.reading is not None:
            reading = named_reading(self.reading)
            wanted |= reading
            if self.body not in (None, reading["body"]):
                wanted["kinematics"] = Kinematics()  # the reading's are those of its own body
        wanted |= {name: x for name in _FIELDS if (x := getattr(self, name)) is not None}
        if self.brain is not None:
            wanted["brain"] = named_brain(self.brain)
        if self.agent_set:
            settings_from(self.agent_set)
            wanted["settings"] = tuple(sorted(self.agent_set))
        for name, words, default in (
            ("kinematics", self.kinematics, Kinematics()),
            ("brain", self.set, Parameters()),
        ):
            if words:
                own = getattr(held.experiment, name) if held else default
                wanted[name] = with_overrides(wanted.get(name, own), words)
        return wanted


def run(out: str | Path, *, quiet: bool = False, **options: Any) -> Run:
    """Simulates all robots that a folder does not hold yet, as `musebot run` does.

    Args:
      out: Folder of the run; an unfinished run continues.
      quiet: Whether to show no progress.
      **options: Options of `musebot run`, with underscores: `task`, `proposer`, `agent`, `robots`,
        `seed`, `brain`, `set` and so on. A single name may stand for a list of one. `set`,
        `agent_set` and `kinematics` may be dictionaries. `processes` is the number of processes.
        A script needs no main guard, unless it defines an agent that it also simulates.

    Returns:
      The run with all robots of the folder.

    Raises:
      TypeError: an option is unknown.
      InputError: a value is invalid, or the folder holds something else; nothing was done.
      Interrupted, RunError, OSError: see `simulation.runs.simulate`.
    """
    names = [field.name for field in dataclasses.fields(RunCommand) if field.name != "workers"]
    workers = [field.name for field in dataclasses.fields(Workers)]
    allowed = sorted({*names, *workers} - {"out"})
    if unknown := sorted({*options} - {*allowed}):
        raise TypeError(f"musebot.run takes the options {', '.join(allowed)}, got {unknown[0]}")
    given = {name: options.pop(name) for name in [*options] if name in workers}
    for name in ("task", "proposer", "agent", "agent_set", "set", "kinematics"):
        if name in options:
            options[name] = _words(options[name])
    if out == "":
        raise InputError("out must name a folder, got ''")
    if options.get("config") is not None:
        options["config"] = Path(options["config"])
    command = RunCommand(Path(out), **options, workers=dataclasses.replace(HERE, **given))
    global _running
    if _running:
        raise InputError(
            "musebot.run was called again while it imported an agent's module: put the call below "
            'if __name__ == "__main__":'
        )
    _running = True
    try:
        return command.simulate(quiet=quiet)
    finally:
        _running = False


_running = False  # whether `run` is simulating


def _words(value: Any) -> tuple[str, ...]:
    """Returns the words of an option: of one name, a list of names, or a dictionary."""
    if isinstance(value, str):
        return (value,)
    if isinstance(value, Mapping):
        return tuple(
            f"{name}={x if isinstance(x, str) else json.dumps(x)}" for name, x in value.items()
        )
    return tuple(value)
