"""`musebot run`: simulates robots."""

from __future__ import annotations

import dataclasses
import itertools
import json
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ...fields import shown
from ..errors import InputError
from ..terminal import show_markdown
from .options import argument, executor, option

if TYPE_CHECKING:
    from ..runs.conditions import Condition
    from ..runs.config import Config
    from ..runs.experiment import Experiment
    from ..runs.plan import Plan
    from ..runs.run import Run as FinishedRun

_ROBOTS = 60  # in each condition, unless --robots, --config or OUT says otherwise
_FIELDS = ("seed", "time_scale", "body", "device")
_WHO, _WORLD, _HOW = "who learns what", "brain and world", "how it is computed"


@dataclasses.dataclass
class Run:
    """Simulate the wanted robots that OUT lacks; can be stopped and continued.

    Options that are not given keep the values in OUT, or have these defaults.
    """

    out: Path = argument("folder of the run", "OUT")
    life: tuple[str, ...] = option(
        (), "`musebot list lives`, or a TOML file (the paper's two)", "LIFE", group=_WHO
    )
    proposer: tuple[str, ...] = option(
        (), "how to propose actions: fixed, random, creative (all)", "NAME", group=_WHO
    )
    agent: tuple[str, ...] = option(
        (), "`musebot list agents`, or package.module:factory", "AGENT", group=_WHO
    )
    trust_agent: bool = option(
        False, "run the code of agents that only OUT or --config names", group=_WHO
    )
    robots: int | None = option(None, "robots in each condition (60)", "N", group=_WHO)
    brain: str | None = option(None, "one of `musebot list brains` (paper)", "NAME", group=_WORLD)
    reading: str | None = option(
        None, "reading of the paper: body, plain (body)", "NAME", group=_WORLD
    )
    body: str | None = option(
        None, "mujoco, or kinematic: a wheeled disc without mass", "NAME", group=_WORLD
    )
    time_scale: float | None = option(
        None, "factor on every duration, in (0, 1], for rehearsals", "X", group=_WORLD
    )
    seed: int | None = option(None, "seed of all random streams (1)", "N", group=_WORLD)
    set: tuple[str, ...] = option(
        (), "fields, as brain.epsilon=0.1 (docs/reference/experiment)", "NAME=X", group=_WORLD
    )
    config: Path | None = option(
        None, "such values: a TOML file, or experiment.json of a run", "FILE", group=_WORLD
    )
    processes: int | None = option(None, "processes of this machine (its cores)", "N", group=_HOW)
    device: str | None = option(None, "cpu, cuda or cuda:N (cpu)", "NAME", group=_HOW)
    ray: str | None = option(None, "Ray cluster instead", "HOST:PORT", group=_HOW)
    save_every: float = option(60.0, "seconds between two checkpoints (60)", "X", group=_HOW)
    tensorboard: bool = option(False, "also write curves to OUT/tensorboard", group=_HOW)

    def __call__(self) -> None:
        """Simulates, and prints the tables."""
        from ..pages import tables
        from ..runs.run_files import TABLES_FILE, read_run
        from ..storage import locked, resolved, write_text

        out = resolved(self.out)  # an agent may change the working directory
        run = self.simulate()
        try:
            with locked(out):  # another command may have added robots meanwhile
                text = tables.markdown(read_run(out, networks=False))
                write_text(out / TABLES_FILE, f"{text}\n")
        except InputError:  # another command is adding some, and will write its own tables
            text = tables.markdown(run)
        show_markdown(text)

    def simulate(self, *, quiet: bool = False) -> FinishedRun:
        """Checks all input, then simulates; returns the run with all robots of OUT.

        Raises:
          InputError: a value is invalid, or OUT holds something else; nothing was done.
          Interrupted, RunError, OSError: see `runs.simulation.simulate`.
        """
        from ..runs.config import Config, read_config
        from ..runs.run_files import planned
        from ..runs.simulation import simulate

        if not isinstance(self.save_every, int | float) or not self.save_every > 0:
            raise InputError(f"save-every must be positive, got {self.save_every}")
        config = read_config(self.config) if self.config else Config()
        held = planned(self.out)
        self._trust(config.robots, held)
        plan = self._plan(config, held)
        return simulate(
            self.out,
            plan,
            executor(self.processes, self.ray, plan.experiment.device),
            save_every=self.save_every,
            quiet=quiet,
            log=self.tensorboard,
        )

    def _trust(self, rows: Iterable[Condition], held: Plan | None) -> None:
        """Trusts agents that the command names; with --trust-agent, those of file and OUT too."""
        from ..agents.factory import check_trusted, trust
        from ..agents.names import recorded_name

        trust(*self.proposer, *map(recorded_name, self.agent))
        if self.trust_agent:
            trust(*(condition.proposer for condition in (*rows, *(held.robots if held else ()))))
        for condition in rows:
            check_trusted(condition.proposer, self.config)

    def _plan(self, config: Config, held: Plan | None) -> Plan:
        """Returns the plan; values are from the command, else the file, else OUT, else defaults."""
        from ...controller import Parameters
        from ..runs.experiment import Experiment, changed
        from ..runs.manifest import check_identity
        from ..runs.plan import Plan, check_robots, default_cohort_size

        if self.robots is not None:
            check_robots(self.robots)
        base = held.experiment if held else Experiment()
        earlier = config.values.get("settings", base.settings)
        values = dict(config.values) | self._values(base, earlier)
        lives = self._lives(values)
        if not (lives or config.robots or held) and values.get("life") is not None:
            lives = [values["life"].name]
        try:
            experiment = changed(base, values)
        except InputError as error:
            source = f"with {self.config}: " if self.config else ""
            raise InputError(f"{source}{error}") from error
        robots = self._robots(config.robots, held.robots if held else {}, lives)
        if held:
            check_identity(self.out, vars(held.experiment), vars(experiment))
        elif "cohort_size" not in values:
            size = default_cohort_size(*robots.values())
            experiment = changed(experiment, {"cohort_size": size})
        for_agents = experiment.settings or experiment.signals == "raw"
        own_brain = self.brain is not None or experiment.brain != Parameters()
        # The command may choose among the conditions that the file plans.
        brains = [condition.has_brain for condition in (*robots, *config.robots)]
        if own_brain and not held and not any(brains):
            raise InputError("a brain is for proposers, and this run has only agents")
        if for_agents and not held and all(brains):
            raise InputError(
                "settings and raw signals change agents only, and this run has none; a brain is "
                "changed by --set brain.NAME=VALUE, for example --set brain.raw_signals=true"
            )
        return Plan(experiment, robots)

    def _lives(self, values: dict[str, Any]) -> list[str]:
        """Returns the names of the lives in --life; adds a life from a file to `values`."""
        from ..runs.config import read_life

        names = []
        for word in self.life:
            if word.endswith(".toml"):
                if values.get("life") is not None:
                    raise InputError(f"a run has one life of one's own, got {word} too")
                values["life"] = read_life(Path(word))
                word = values["life"].name
            names.append(word)
        return names

    def _values(self, base: Experiment, earlier: Any) -> dict[str, Any]:
        """Returns the values that the command gives, as `experiment.changed` takes them.

        Settings of agents that the command does not give are those of `earlier`.
        """
        from ...controller import Parameters
        from ...models import Kinematics
        from ..agents.settings import settings_from
        from ..runs.config import named_brain, named_reading, values_of

        parts = {"brain": Parameters, "kinematics": Kinematics}
        own = [field.name for field in dataclasses.fields(base)]
        known = ["agent.NAME", *(name for name in own if name not in (*parts, "settings", "life"))]
        for part, cls in parts.items():
            known += [f"{part}.{field.name}" for field in dataclasses.fields(cls)]
        given = values_of([word for word in self.set if not word.startswith("agent.")], known)
        values: dict[str, Any] = {}
        if self.reading is not None:
            values |= named_reading(self.reading)
            if given.get("body", self.body) not in (None, values["body"]):
                values["kinematics"] = Kinematics()  # the reading's kinematics fit only its body
        values |= {name: x for name in _FIELDS if (x := getattr(self, name)) is not None}
        if self.brain is not None:
            values["brain"] = named_brain(self.brain)
        settings = [word[6:] for word in self.set if word.startswith("agent.")]
        if settings:
            names = settings_from(settings, several=True)  # refuses what is no setting
            words = map(str, earlier if isinstance(earlier, list | tuple) else ())
            kept = (word for word in words if word.partition("=")[0] not in names)
            values["settings"] = tuple(sorted([*kept, *settings]))
        for name in _FIELDS:
            if name in given and getattr(self, name) is not None:
                raise InputError(f"{name} is given twice, by --{name.replace('_', '-')} and --set")
        return values | given

    def _robots(
        self, rows: Mapping[Condition, int], held: Mapping[Condition, int], lives: Iterable[str]
    ) -> dict[Condition, int]:
        """Returns the wanted number of robots of each condition."""
        from ...controller import PROPOSERS
        from ...tasks.lives import PAPER_LIVES
        from ..agents.names import recorded_name
        from ..runs.conditions import Condition

        known = rows or held
        chosen = (*self.proposer, *map(recorded_name, self.agent))
        pairs = itertools.product(
            lives or dict.fromkeys(c.life for c in known) or PAPER_LIVES,
            chosen or dict.fromkeys(c.proposer for c in known) or PROPOSERS,
        )
        conditions = [Condition(*pair) for pair in pairs]
        if not (lives and chosen):
            conditions = [c for c in conditions if c in known] or conditions
        if rows and (foreign := [c for c in conditions if c not in rows]):
            raise InputError(
                f"{self.config} plans {', '.join(map(str, rows))}: --life, --proposer and --agent "
                f"choose among these, got {foreign[0]}"
            )
        usual = max(known.values(), default=_ROBOTS)
        return {condition: self.robots or known.get(condition, usual) for condition in conditions}


def run(out: str | Path, *, quiet: bool = False, **options: Any) -> FinishedRun:
    """Simulates the wanted robots that a folder does not hold yet, as `musebot run` does.

    Args:
      out: Folder of the run: a new one, or that of a run to continue.
      quiet: Whether to hide the progress.
      **options: Options of `musebot run`, with underscores: `life`, `proposer`, `agent`, `robots`,
        `seed`, `brain`, `set` and so on. A single name may stand for a list of one. `set` may be a
        dictionary, such as {"brain.epsilon": 0.1}. A script needs no main guard, unless it defines
        an agent that it also simulates.

    Returns:
      The run with all robots of the folder.

    Raises:
      TypeError: an option is unknown.
      InputError: a value is invalid, or the folder holds something else; nothing was done.
      Interrupted, RunError, OSError: see `runs.simulation.simulate`.
    """
    allowed = sorted(field.name for field in dataclasses.fields(Run) if field.name != "out")
    if unknown := sorted({*options} - {*allowed}):
        raise TypeError(f"musebot.run takes the options {', '.join(allowed)}, got {unknown[0]}")
    options = {name: _plain(value) for name, value in options.items()}
    for name in ("life", "proposer", "agent", "set"):
        if name in options:
            options[name] = _words(options[name])
    if out == "":
        raise InputError("out must name a folder, got ''")
    if options.get("config") is not None:
        options["config"] = Path(options["config"])
    command = Run(Path(out), **options)
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
    """Returns an option's words, given one name, a list of names, or a dictionary."""
    if value is None:
        return ()
    if isinstance(value, Mapping):
        return tuple(
            f"{name}={x if isinstance(x, str) else json.dumps(x, default=_listed)}"
            for name, x in value.items()
        )
    several = isinstance(value, Iterable) and not isinstance(value, str | Path)
    return tuple(map(str, value if several else [value]))


def _plain(value: Any) -> Any:
    """Returns a NumPy value as Python numbers, and any other value unchanged."""
    return value.tolist() if hasattr(value, "tolist") else value


def _listed(value: Any) -> Any:
    """Returns a NumPy value inside of `set` as numbers; raises InputError for any other value."""
    if not hasattr(value, "tolist"):
        raise InputError(f"set takes numbers, texts and lists of these, got {shown(value)}")
    return value.tolist()
