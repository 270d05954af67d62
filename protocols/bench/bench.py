"""How fast everything is, against the physics itself: ratios measured in turns, in one run.

docs/performance.md says how each is measured; `musebot bench` prints them as Markdown.
"""

from __future__ import annotations

import dataclasses
import json
import os
import sys
import time
from collections.abc import Iterable, Iterator
from pathlib import Path
from statistics import median
from typing import Any

import mujoco
import torch
from rich.console import Console
from rich.markdown import Markdown

from ...controller import PROPOSERS
from ...tasks import CONTROL_TIMESTEP, stop_timers
from ..errors import InputError
from ..experiment.experiment import TASKS, Experiment, machine
from ..options import cores
from ..storage import check_place, write_atomically
from . import lives, models
from .lives import Act, BrainCost, Comparison, Scaling, Setting
from .models import EnvironmentCost, StepCost

MAIN, SMALL = 250, 50  # robots in a process: a run's cohorts, and a small cohort
SIZES = (1, 2, 5, 10, 20, SMALL, 100, MAIN, 500, 1000, 2000)
MEMORY_SIZES = (SMALL, MAIN, 1000)
PAPER, STEADY = "paper", "steady"  # brains
TABLE_ROBOTS = 500  # in each condition of the paper's tables
_LONGEST = 500  # control steps in a block


@dataclasses.dataclass(frozen=True)
class Effort:
    """How long everything is measured.

    Attributes:
      blocks: of a life in turns with its bare physics, for the throughput of wall avoidance.
      fewer_blocks: the same for other lives and numbers of robots.
      robot_steps: robot-control-steps in a block, about.
      turns: of one process, two, and all.
      rounds: of the models' and the environments' steps.
      physics_steps: of a model in a round.
      env_steps: of an environment in a round.
      memory_steps: control steps before a process's memory is read.
    """

    blocks: int
    fewer_blocks: int
    robot_steps: int
    turns: int
    rounds: int
    physics_steps: int
    env_steps: int
    memory_steps: int

    def setting(self, task: str, proposer: str, robots: int) -> Setting:
        """A life in blocks of this effort's length."""
        # A life draws its noise patterns anew every 500 steps: with few robots, where that is
        # felt, once in every block; with many it is less than a percent of anything.
        steps = max(1, min(self.robot_steps // robots, _LONGEST))
        return Setting(task, proposer, robots, steps)


FULL = Effort(7, 3, 12_500, 6, 100, 3000, 200, 100)
QUICK = Effort(1, 1, 50, 1, 3, 150, 10, 2)


@dataclasses.dataclass(frozen=True)
class Section:
    """A part of the report.

    Attributes:
      title: its heading.
      text: what is measured.
      head: of the table's columns.
      rows: of the table.
    """

    title: str
    text: str
    head: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]

    def markdown(self) -> str:
        """Heading, text and table."""
        rule = ("---", *("---:" for _ in self.head[1:]))
        table = "\n".join(f"| {' | '.join(row)} |" for row in (self.head, rule, *self.rows))
        return f"### {self.title}\n\n{self.text}\n\n{table}\n"


@dataclasses.dataclass(frozen=True)
class Measured:
    """Everything that one run measured.

    Attributes:
      lives: each task and proposer beside its bare physics, wall avoidance with two numbers of
        robots.
      sizes: creative wall avoidance with every number of robots.
      brains: by task, what our brain and the paper's cost, creative robots.
      timers: seconds of a bare block with MuJoCo's timers on, and off.
      scaling: one process against several, living and replaying.
      steps: cost of a physics step of each model, by name.
      environments: cost of `env.step`, ours and point_mass's, by name.
      memory: peak of a process in MB, by its number of robots.
    """

    lives: tuple[Comparison, ...]
    sizes: tuple[Comparison, ...]
    brains: dict[str, dict[str, BrainCost]]
    timers: tuple[float, float]
    scaling: dict[Act, Scaling]
    steps: dict[str, StepCost]
    environments: dict[str, EnvironmentCost]
    memory: dict[int, float]

    def life(self, task: str, proposer: str, robots: int) -> Comparison:
        """The comparison of that setting."""
        for life in self.lives:
            setting = life.setting
            if (setting.task, setting.proposer, setting.robots) == (task, proposer, robots):
                return life
        raise KeyError(f"{task}, {proposer}, {robots} robots were not measured")

    def brain_ratio(self, task: str) -> float:
        """What our brain costs over what the paper's does."""
        return self.brains[task][STEADY].ratio(self.brains[task][PAPER])

    @property
    def step_ratio(self) -> float:
        """A step of our model over one of the car-like model."""
        return self.steps[models.OURS].ratio(self.steps[models.LIKE_CAR])

    @property
    def env_overhead(self) -> float:
        """Microseconds of `env.step` outside the physics, in the dearer of our tasks."""
        return max(self.environments[task].overhead_us for task in TASKS)

    @property
    def point_mass_overhead(self) -> float:
        """The same of dm_control's point_mass."""
        return self.environments["point_mass"].overhead_us

    @property
    def realtime_factor(self) -> float:
        """Robot-seconds that all cores together simulate in a second."""
        return self.scaling["live"].robot_steps_per_second * CONTROL_TIMESTEP

    def hours(self, task: str, proposer: str) -> float:
        """What a table's column takes with two processes, at the rate of training throughout."""
        steps = sum(Experiment().schedule(task).steps())
        seconds = self.life(task, proposer, MAIN).microseconds["total"] * 1e-6
        return TABLE_ROBOTS * steps * seconds / self.scaling["live"].ratio / 3600

    @property
    def tables_hours(self) -> float:
        """What both of the paper's tables take with two processes."""
        return sum(self.hours(task, proposer) for task in TASKS for proposer in PROPOSERS)


def run(
    json_file: Path | None = None,
    figure: Path | None = None,
    own_car: Path | None = None,
    quick: bool = False,
) -> None:
    """Measures everything, and prints a section as soon as it is known.

    Args:
      json_file: where to keep all numbers, too.
      figure: where to draw the cost against the number of robots.
      own_car: MuJoCo's own model/car/car.xml; None looks for it where MuJoCo usually is.
      quick: measures next to nothing, to see that everything works.

    Raises:
      InputError: a file cannot be written, or the car cannot be read.
      RunError: a process died, or a replay was not equal to its life.
    """
    for path, suffixes in ((json_file, ()), (figure, (".svg", ".png", ".pdf"))):
        if path is not None:
            _check_output(path, suffixes)
    car = _car(own_car)
    torch.set_num_threads(1)
    # For the processes started below, as a run has it for its own.
    os.environ.update(OMP_NUM_THREADS="1", MKL_NUM_THREADS="1", MUJOCO_GL="off")
    here = machine() | {
        "cores_used": cores(),
        "load_before": os.getloadavg()[0],  # 0 on an idle machine
        "timers_stopped": stop_timers(),
        "quick": quick,
    }
    effort = QUICK if quick else FULL
    report = _Report()
    report.show(_machine_section(here))
    measured = _measure(effort, car, report)
    report.show(_bars_section(measured))
    if figure is not None:
        draw(measured.sizes, figure)
    if json_file is not None:
        content = as_json(measured) | {"machine": here, "raw": _raw(measured)}
        write_atomically(json_file, (json.dumps(content, indent=2) + "\n").encode())


def _check_output(path: Path, suffixes: tuple[str, ...]) -> None:
    if suffixes and path.suffix.lower() not in suffixes:
        raise InputError(f"the figure must be one of {', '.join(suffixes)}, got {path}")
    check_place(path)


def _car(path: Path | None) -> mujoco.MjModel | None:
    try:
        return models.car_xml(path)
    except ValueError as error:
        reason = " ".join(str(error).split())
        raise InputError(f"{path} is no model that MuJoCo can read ({reason})") from error


def _measure(effort: Effort, car: mujoco.MjModel | None, report: _Report) -> Measured:
    """Everything, a section after the other."""
    compared = tuple(_compare_lives(effort, report))
    report.show(_throughput_section(compared))

    sizes = tuple(_compare_sizes(effort, compared, report))
    report.show(_sizes_section(sizes))

    brains = {}
    for task in TASKS:
        report.begin(f"brains, {task}")
        setting = effort.setting(task, "creative", MAIN)
        brains[task] = lives.brain_costs(setting, (PAPER, STEADY), effort.blocks)
    report.show(_brains_section(brains))

    main = effort.setting("wall_avoidance", "creative", MAIN)
    report.begin("timers on and off")
    timers = lives.with_and_without_timers(main, effort.fewer_blocks)
    report.show(_timers_section(timers, main))

    report.begin("processes")
    scaling = lives.scaling(main, cores(), effort.turns)
    report.show(_scaling_section(scaling))

    report.begin("models")
    steps = models.step_costs(car, effort.rounds, effort.physics_steps)
    report.show(_steps_section(steps))

    report.begin("environments")
    costs = models.environment_costs(effort.rounds, effort.env_steps)
    report.show(_environments_section(costs))

    memory = {}
    for robots in MEMORY_SIZES:
        report.begin(f"memory, {robots} robots")
        setting = Setting("wall_avoidance", "creative", robots, effort.memory_steps)
        memory[robots] = lives.peak_memory(setting)
    report.show(_memory_section(memory))

    environments = {cost.name: cost for cost in costs}
    measured = Measured(compared, sizes, brains, timers, scaling, steps, environments, memory)
    report.show(_hours_section(measured))
    return measured


def _compare_lives(effort: Effort, report: _Report) -> Iterator[Comparison]:
    wanted = [("wall_avoidance", p, n, effort.blocks) for p in PROPOSERS for n in (SMALL, MAIN)]
    wanted += [("spot_finding", p, MAIN, effort.fewer_blocks) for p in PROPOSERS]
    for task, proposer, robots, blocks in wanted:
        report.begin(f"{task}, {proposer}, {robots} robots")
        yield lives.compare(effort.setting(task, proposer, robots), blocks)


def _compare_sizes(
    effort: Effort, compared: Iterable[Comparison], report: _Report
) -> Iterator[Comparison]:
    known = {life.setting: life for life in compared}
    for robots in SIZES:
        setting = effort.setting("wall_avoidance", "creative", robots)
        if setting not in known:
            report.begin(f"cost with robots: {robots}")
            known[setting] = lives.compare(setting, effort.fewer_blocks)
        yield known[setting]


def _machine_section(here: dict[str, Any]) -> Section:
    text = "Where everything below was measured."
    if here["quick"]:
        text += " **With --quick: far too short to be quoted.**"
    rows = tuple((_words(name), str(value)) for name, value in here.items())
    return Section("Machine", text, ("", "value"), rows)


def _throughput_section(compared: Iterable[Comparison]) -> Section:
    rows = []
    for life in compared:
        us = life.microseconds
        rows.append(
            (
                f"{_words(life.setting.task)}, {life.setting.proposer}",
                str(life.setting.robots),
                f"{1e6 / us['total']:,.0f}",
                f"{1e6 / us['bare']:,.0f}",
                f"**{life.ratio:.3f}**",
                f"{min(life.ratios):.3f} to {max(life.ratios):.3f}",
                f"{us['brain'] + us['rest']:.1f}",
            )
        )
    return Section(
        "Lives against bare physics",
        "Robot-control-steps a second of robots that learn (sensors, brain, bookkeeping, "
        "physics), and of `mujoco.rollout` alone, which replays the motors of the same robots "
        "from the same states, one call a control step; one thread, in turns, medians of "
        "blocks. The bare rollout evaluates sensors in every substep, a life in the last one.",
        (
            "life",
            "robots",
            "life, steps/s",
            "bare, steps/s",
            "ratio",
            "blocks",
            "not physics, us a robot-step",
        ),
        tuple(rows),
    )


def _sizes_section(sizes: Iterable[Comparison]) -> Section:
    rows = []
    for life in sizes:
        us = life.microseconds
        cells = (f"{us[part]:.1f}" for part in ("total", "physics", "brain", "rest", "bare"))
        rows.append((str(life.setting.robots), *cells, f"{life.ratio:.3f}"))
    return Section(
        "Cost against the number of robots",
        "Microseconds a robot-control-step of creative wall avoidance in one process. Physics "
        "is MuJoCo, brain is acting and learning, rest is sensors, rewards, bookkeeping and the "
        "hand-over between them; ratio is bare over total.",
        ("robots", "total", "physics", "brain", "rest", "bare", "ratio"),
        tuple(rows),
    )


def _brains_section(brains: dict[str, dict[str, BrainCost]]) -> Section:
    rows = []
    for task, costs in brains.items():
        for name, cost in costs.items():
            numbers = cost.microseconds, cost.ratio(costs[PAPER]), cost.share
            cells = (f"{x:{form}}" for x, form in zip(numbers, (".1f", ".2f", ".3f"), strict=True))
            rows.append((f"{_words(task)}, {name}", *cells))
    return Section(
        "Two brains",
        f"What acting and learning take of the lives of {MAIN} creative robots in one process, "
        "with the paper's brain and with ours, in turns, medians of blocks.",
        ("life", "brain, us a robot-step", "against the paper's", "share of the time"),
        tuple(rows),
    )


def _timers_section(timers: tuple[float, float], setting: Setting) -> Section:
    on, off = (1e6 * seconds / setting.robot_steps for seconds in timers)
    return Section(
        "MuJoCo's timers",
        "A bare rollout in two processes in turns, one with MuJoCo's own stage timers running, "
        "as they do by default, one with them stopped, as in lives and bare replays above.",
        ("timers", "bare, steps/s", "us a robot-step"),
        (("on", f"{1e6 / on:,.0f}", f"{on:.1f}"), ("off", f"{1e6 / off:,.0f}", f"{off:.1f}")),
    )


def _scaling_section(scaling: dict[Act, Scaling]) -> Section:
    names: dict[Act, str] = {"live": "lives", "replay": "bare rollout"}
    rows = []
    for act, name in names.items():
        times = scaling[act]
        one = times.setting.robot_steps / median(times.one)
        rows.append(
            (
                name,
                f"{one:,.0f}",
                f"{one * times.ratio:,.0f}",
                f"**{times.ratio:.3f}**",
                f"{times.robot_steps_per_second:,.0f}",
            )
        )
    return Section(
        "Processes",
        f"Robot-control-steps a second of creative wall avoidance, {MAIN} robots a process: one "
        "process alone, two at the same time with the same work each, in turns; and as many as "
        "there are cores.",
        ("", "one", "two", "two against one", f"all {scaling['live'].processes}"),
        tuple(rows),
    )


def _steps_section(steps: dict[str, StepCost]) -> Section:
    rows = []
    for cost in steps.values():
        rows.append(
            (
                cost.name,
                str(cost.freedoms),
                str(cost.geoms),
                str(cost.sensors),
                f"{cost.contacts:.1f}",
                f"{cost.rows:.1f}",
                f"{1e3 * cost.timestep:.2f}",
                f"{1e6 * median(cost.seconds):.2f}",
                f"**{cost.ratio(steps[models.LIKE_CAR]):.3f}**",
            )
        )
    return Section(
        "A physics step beside a car's",
        "`mj_step` of our robot in its arena, and of a free two-wheeled car of as many degrees "
        "of freedom (ours, like MuJoCo's `model/car/car.xml` in structure; and that file itself "
        "where it was at hand), random controls drawn anew every 0.1 s, in turns, timers "
        "stopped.",
        (
            "model",
            "degrees of freedom",
            "geoms",
            "sensors",
            "contacts, mean",
            "constraint rows, mean",
            "timestep, ms",
            "us a step",
            "against car-like",
        ),
        tuple(rows),
    )


def _environments_section(costs: Iterable[EnvironmentCost]) -> Section:
    rows = tuple(
        (
            cost.name if cost.name == "point_mass" else _words(cost.name),
            str(cost.substeps),
            f"{1e6 * median(cost.step):.1f}",
            f"{1e6 * median(cost.bare):.1f}",
            f"**{cost.overhead_us:.1f}**",
        )
        for cost in costs
    )
    return Section(
        "A step of the environment",
        "`env.step` of our dm_control tasks and of dm_control's own point_mass, less the bare "
        "physics steps that it contains (the same from the same state, in turns), microseconds.",
        ("environment", "physics steps", "env.step", "its physics steps", "outside them"),
        rows,
    )


def _memory_section(memory: dict[int, float]) -> Section:
    return Section(
        "Memory",
        "Peak of a fresh process that lives creative wall avoidance for a while and saves a "
        "checkpoint, in MB (10^6 bytes).",
        ("robots", "peak, MB"),
        tuple((str(robots), f"{peak:.0f}") for robots, peak in memory.items()),
    )


def _hours_section(measured: Measured) -> Section:
    rows = [
        (
            f"{_words(task)}, {proposer}",
            f"{sum(Experiment().schedule(task).steps()):,}",
            f"{measured.life(task, proposer, MAIN).microseconds['total']:.1f}",
            f"{measured.hours(task, proposer):.2f}",
        )
        for task in TASKS
        for proposer in PROPOSERS
    ]
    rows.append(("both tables", "", "", f"**{measured.tables_hours:.2f}**"))
    return Section(
        "The paper's tables",
        f"Hours with two processes of {MAIN} robots for {TABLE_ROBOTS} robots in each of the six "
        "conditions, at the rates of training above, dearer than the tests that are the rest of "
        f"a life. All cores together simulate {measured.realtime_factor:,.0f} robot-seconds a "
        "second (creative wall avoidance).",
        ("condition", "control steps a life", "us a robot-step", "hours"),
        tuple(rows),
    )


def _bars_section(measured: Measured) -> Section:
    two, bare = measured.scaling["live"].ratio, measured.scaling["replay"].ratio
    env, point = measured.env_overhead, measured.point_mass_overhead
    ratios = [
        (proposer, robots, measured.life("wall_avoidance", proposer, robots).ratio, bar)
        for proposer, robots, bar in (
            ("creative", MAIN, 0.86),
            ("creative", SMALL, 0.70),
            ("fixed", MAIN, 0.92),
            ("random", MAIN, 0.92),
        )
    ]
    bars = [
        (f"{proposer}, {robots} robots, against bare", f"{ratio:.3f}", f">= {bar}", ratio >= bar)
        for proposer, robots, ratio, bar in ratios
    ]
    for task in TASKS:
        name = f"{STEADY}'s acting and learning against the {PAPER} brain's, {_words(task)}"
        ratio = measured.brain_ratio(task)
        bars.append((name, f"{ratio:.2f}", "<= 2", ratio <= 2))
    bars += [
        (
            "two processes against one",
            f"{two:.3f}, bare {bare:.3f}",
            ">= 1.9, or 0.97 of bare",
            two >= 1.9 or two >= 0.97 * bare,
        ),
        (
            "a physics step against car-like",
            f"{measured.step_ratio:.3f}",
            "<= 0.65",
            measured.step_ratio <= 0.65,
        ),
        (
            "env.step outside physics, us",
            f"{env:.1f}, point_mass {point:.1f}",
            "<= 80, or 1.3 of point_mass",
            env <= 80 or env <= 1.3 * point,
        ),
        (
            "both tables, hours",
            f"{measured.tables_hours:.2f}",
            "<= 4.5",
            measured.tables_hours <= 4.5,
        ),
        (
            "memory of 1000 robots, MB",
            f"{measured.memory[1000]:.0f}",
            "< 1500",
            measured.memory[1000] < 1500,
        ),
    ]
    return Section(
        "Bars",
        "What musebot holds itself to.",
        ("", "measured", "bar", "met"),
        tuple((*cells, "yes" if met else "**no**") for *cells, met in bars),
    )


def as_json(measured: Measured) -> dict[str, Any]:
    """The figures, as plain data."""
    ratios = {
        p: {str(n): measured.life("wall_avoidance", p, n).ratio for n in (SMALL, MAIN)}
        for p in PROPOSERS
    }
    spot = {p: {str(MAIN): measured.life("spot_finding", p, MAIN).ratio} for p in PROPOSERS}
    on, off = measured.timers
    steps = measured.steps
    return {
        "throughput_ratio": ratios,
        "throughput_ratio_spot_finding": spot,
        "robot_step_us": {
            f"{c.setting.task}/{c.setting.proposer}/{c.setting.robots}": c.microseconds["total"]
            for c in measured.lives
        },
        "not_physics_us": {
            f"{c.setting.task}/{c.setting.proposer}/{c.setting.robots}": c.microseconds["brain"]
            + c.microseconds["rest"]
            for c in measured.lives
        },
        "cost_us": {str(c.setting.robots): c.microseconds for c in measured.sizes},
        "brain_us": {
            task: {name: cost.microseconds for name, cost in costs.items()}
            for task, costs in measured.brains.items()
        },
        "brain_cost_ratio": {task: measured.brain_ratio(task) for task in TASKS},
        "timers_on_cost_ratio": on / off,
        "process_scaling": measured.scaling["live"].ratio,
        "process_scaling_bare": measured.scaling["replay"].ratio,
        "step_cost_ratio_car": measured.step_ratio,
        "step_cost_us": {name: 1e6 * median(cost.seconds) for name, cost in steps.items()},
        "step_cost_ratios": {
            name: cost.ratio(steps[models.LIKE_CAR]) for name, cost in steps.items()
        },
        "env_step_overhead_us": measured.env_overhead,
        "point_mass_overhead_us": measured.point_mass_overhead,
        "tables_hours_2_cores": measured.tables_hours,
        "peak_memory_mb": {str(robots): peak for robots, peak in measured.memory.items()},
        "realtime_factor": measured.realtime_factor,
    }


def _raw(measured: Measured) -> dict[str, Any]:
    raw = dataclasses.asdict(measured)
    raw["memory"] = {str(robots): peak for robots, peak in measured.memory.items()}
    return raw


def draw(sizes: Iterable[Comparison], path: Path) -> None:
    """Draws the cost of a robot-step against the number of robots."""
    from matplotlib.figure import Figure

    robots = [life.setting.robots for life in sizes]
    figure = Figure(figsize=(7, 4), layout="constrained")
    axes = figure.add_subplot()
    styles = {"total": "o-k", "physics": "s-C0", "brain": "^-C1", "rest": "v-C2"}
    for part, style in styles.items():
        axes.loglog(robots, [life.microseconds[part] for life in sizes], style, label=part)
    axes.set_xlabel("robots in a process")
    axes.set_ylabel("\N{MICRO SIGN}s a robot-control-step")
    axes.set_title("Creative wall avoidance while learning, one thread")
    axes.set_xticks(robots, [str(n) for n in robots])
    axes.minorticks_off()
    axes.grid(alpha=0.3)
    axes.legend()
    figure.savefig(path)


def _words(name: str) -> str:
    return name.replace("_", " ")


class _Report:
    """Sections to standard output, progress to standard error."""

    def __init__(self) -> None:
        self._console = Console()
        self._began = time.monotonic()

    def begin(self, what: str) -> None:
        """Says what is being measured."""
        # A line, not a bar: a bar is drawn by a thread of its own, which would be measured too.
        seconds = time.monotonic() - self._began
        print(f"{seconds:4.0f} s  measuring {what}", file=sys.stderr, flush=True)

    def show(self, section: Section) -> None:
        """Prints a section: Markdown, drawn where it goes to a terminal."""
        if self._console.is_terminal:
            self._console.print(Markdown(section.markdown()))
        else:
            print(section.markdown(), flush=True)
