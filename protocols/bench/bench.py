"""The benchmark: makes one measurement after another and prints each as Markdown.

docs/performance.md describes the methods.
"""

from __future__ import annotations

import dataclasses
import json
import os
import sys
import time
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

import mujoco
import torch

from ...tasks import stop_timers
from ..errors import InputError
from ..lives.conditions import PAPER_TASKS
from ..lives.manifest import machine
from ..machine import cores
from ..pages import style
from ..storage import check_place, resolved_file, write_atomically
from ..terminal import notice, remaining, show_markdown
from . import lives, models, population, sections, workers
from .lives import PairedTiming, Setting, TimedCohort
from .measurements import (
    MAIN,
    PAPER,
    PROPOSERS,
    SMALL,
    STEADY,
    Measurements,
    as_json,
    draw,
)
from .memory import peak_memory
from .targets import targets_section

SIZES = (1, 2, 5, 10, 20, SMALL, 100, MAIN, 500, 1000, 2000)
MEMORY_SIZES = (SMALL, MAIN, 1000)
_LONGEST = 500  # control steps in a block


@dataclasses.dataclass(frozen=True)
class Effort:
    """Numbers of blocks, rounds and steps in all measurements.

    Attributes:
      blocks: Number of blocks of each cohort in wall avoidance, which is also that of each brain.
      fewer_blocks: Number of blocks of measurements that need less precision: spot finding, other
        cohort sizes, and the cost of MuJoCo's timers.
      robot_steps: Approximate number of robot-steps in a block.
      turns: Number of times that one, two and all processes are timed.
      rounds: Number of timed rounds of each model and of each environment.
      physics_steps: Minimum number of physics steps of each model in a round.
      env_steps: Number of calls of each environment's `step` in a round.
      memory_steps: Number of control steps that a process simulates before its peak memory is read.
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
        """Returns the setting of a cohort, with about `robot_steps` robot-steps in a block."""
        # The creative memory draws its noise patterns every 500 steps. With few robots that
        # matters, and every block contains it once; with many it is below one percent.
        steps = max(1, min(self.robot_steps // robots, _LONGEST))
        return Setting(task, proposer, robots, steps)


FULL = Effort(7, 3, 12_500, 6, 100, 3000, 200, 100)
QUICK = Effort(1, 1, 50, 1, 3, 150, 10, 2)


def run(
    json_file: Path | None = None,
    figure: Path | None = None,
    own_car: Path | None = None,
    quick: bool = False,
    interfaces: bool = False,
    device: str | None = None,
) -> None:
    """Measures everything and prints every section as soon as it is known.

    Args:
      json_file: File to which all numbers are written; None for no file.
      figure: File to which the plot of cost against number of robots is written; None for no plot.
      own_car: Path of MuJoCo's own model/car/car.xml; None searches the usual folders.
      quick: Whether to measure as little as possible, to check that everything works.
      interfaces: Whether to measure only the Gymnasium interfaces.
      device: Device on which to measure only populations of robots; None for all but that.

    Raises:
      InputError: A file cannot be written, the car cannot be read, a package or the device is
        missing, or options exclude each other.
      RunError: A process died, or the final states of a replay differ from its cohort's.
    """
    json_file, figure = (path and resolved_file(path) for path in (json_file, figure))
    if json_file is not None:
        check_place(json_file)
    if figure is not None:
        style.check_output(figure, (*style.FORMATS, "pdf"))
    others = {"--interfaces": interfaces, "--device": device is not None}
    for option in (name for name, given in others.items() if given):
        if figure or own_car:
            raise InputError(f"{option} cannot be combined with --figure or --car-xml")
        if all(others.values()):
            raise InputError("--interfaces cannot be combined with --device")
    if device is not None:
        population.check_device(device)
    car = None if any(others.values()) else _car(own_car)
    torch.set_num_threads(1)
    # For the processes started below, as in a run.
    os.environ.update(OMP_NUM_THREADS="1", MKL_NUM_THREADS="1", MUJOCO_GL="off")
    here = machine() | {
        "cores_used": cores(),
        "load_before": os.getloadavg()[0],  # 0 on an idle machine
        # Users of Gymnasium have MuJoCo's timers on.
        "timers_stopped": not interfaces and stop_timers(),
        "quick": quick,
    }
    printer = _Printer(_measurements(quick, interfaces, device))
    printer.show(sections.machine_section(here))
    if interfaces:
        content = _measure_interfaces(quick, printer)
    elif device is not None:
        content = {"population": _measure_population(device, quick, printer)}
    else:
        measured = _measure(QUICK if quick else FULL, car, printer)
        printer.show(targets_section(measured))
        if figure is not None:
            draw(measured.sizes, figure)
        content = as_json(measured)
    if json_file is not None:
        content |= {"machine": here}
        write_atomically(json_file, (json.dumps(content, indent=2) + "\n").encode())


def _car(path: Path | None) -> mujoco.MjModel | None:
    if (path := path or models.car_xml()) is None:
        return None
    try:
        return mujoco.MjModel.from_xml_path(str(path))
    except ValueError as error:
        reason = " ".join(str(error).split())
        raise InputError(f"{path} is not a model that MuJoCo can read ({reason})") from error


def _measure_interfaces(quick: bool, printer: _Printer) -> dict[str, Any]:
    try:
        from .gymnasium import measure
    except ImportError as error:
        raise InputError(
            f"--interfaces needs the extra gym: pip install 'musebot[gym]' ({error})"
        ) from error
    printer.begin("the Gymnasium interfaces")
    costs = measure(robots=4, rounds=1, steps=2) if quick else measure()
    printer.show(costs.section())
    return {"interfaces": dataclasses.asdict(costs)}


def _measurements(quick: bool, interfaces: bool, device: str | None) -> int:
    """Returns how often `_Printer.begin` is called."""
    if interfaces:
        return 1
    if device is not None:
        return len(population.sizes(device, quick))
    conditions = len(PROPOSERS) * 3
    sizes = len(set(SIZES) - {SMALL, MAIN})
    return conditions + sizes + len(PAPER_TASKS) + 4 + len(MEMORY_SIZES)


def _measure_population(device: str, quick: bool, printer: _Printer) -> list[dict[str, Any]]:
    rates = []
    for robots in population.sizes(device, quick):
        printer.begin(f"{robots} robots on {device}")
        rates.append(population.measure(device, robots, 0.05 if quick else 3.0))
    printer.show(population.section(device, rates))
    return [dataclasses.asdict(rate) for rate in rates]


def _measure(effort: Effort, car: mujoco.MjModel | None, printer: _Printer) -> Measurements:
    timings = tuple(_time_conditions(effort, printer))
    printer.show(sections.lives_section(timings))

    sizes = tuple(_time_sizes(effort, timings, printer))
    printer.show(sections.sizes_section(sizes))

    brains = {}
    for task in PAPER_TASKS:
        printer.begin(f"brains, {task}")
        setting = effort.setting(task, "creative", MAIN)
        cohorts = [
            TimedCohort(dataclasses.replace(setting, brain=name)) for name in (PAPER, STEADY)
        ]
        brains[task] = lives.brain_costs(cohorts, effort.blocks)
    printer.show(sections.brains_section(brains))

    main = effort.setting("wall_avoidance", "creative", MAIN)
    printer.begin("MuJoCo's timers")
    timers = workers.timer_cost(main, effort.fewer_blocks)
    printer.show(sections.timers_section(timers, main))

    printer.begin("processes")
    scaling = workers.scaling(main, cores(), effort.turns)
    printer.show(sections.scaling_section(scaling))

    printer.begin("models")
    steps = models.step_costs(car, effort.rounds, effort.physics_steps)
    printer.show(sections.steps_section(steps))

    printer.begin("environments")
    costs = models.environment_costs(effort.rounds, effort.env_steps)
    printer.show(sections.environments_section(costs))

    memory = {}
    for robots in MEMORY_SIZES:
        printer.begin(f"memory, {robots} robots")
        setting = Setting("wall_avoidance", "creative", robots, effort.memory_steps)
        memory[robots] = peak_memory(setting)
    printer.show(sections.memory_section(memory))

    environments = {cost.name: cost for cost in costs}
    measured = Measurements(timings, sizes, brains, timers, scaling, steps, environments, memory)
    printer.show(sections.hours_section(measured))
    return measured


def _time_conditions(effort: Effort, printer: _Printer) -> Iterator[PairedTiming]:
    wanted = [("wall_avoidance", p, n, effort.blocks) for p in PROPOSERS for n in (SMALL, MAIN)]
    wanted += [("spot_finding", p, MAIN, effort.fewer_blocks) for p in PROPOSERS]
    for task, proposer, robots, blocks in wanted:
        printer.begin(f"{task}, {proposer}, {robots} robots")
        yield lives.time_pairs(effort.setting(task, proposer, robots), blocks)


def _time_sizes(
    effort: Effort, timings: Iterable[PairedTiming], printer: _Printer
) -> Iterator[PairedTiming]:
    known = {timing.setting: timing for timing in timings}
    for robots in SIZES:
        setting = effort.setting("wall_avoidance", "creative", robots)
        if setting not in known:
            printer.begin(f"cost with {robots} robots")
            known[setting] = lives.time_pairs(setting, effort.fewer_blocks)
        yield known[setting]


class _Printer:
    """Prints sections to standard output and progress to standard error."""

    def __init__(self, measurements: int) -> None:
        """Begins with the first of a number of measurements."""
        self._began = time.monotonic()
        self._number, self._measurements = 0, measurements

    def begin(self, what: str) -> None:
        """Prints what is being measured, how long it has taken and about how long is left."""
        # A line, not a progress bar: a bar has a thread of its own, which would be measured.
        seconds, done = time.monotonic() - self._began, self._number
        self._number += 1
        left = remaining(seconds / done * (self._measurements - done)) if done else ""
        of = f"{self._number} of {self._measurements}"
        notice(", ".join(filter(None, [f"measuring {what}", of, f"{seconds:.0f} s", left])))

    def show(self, section: str) -> None:
        """Prints a section: formatted on a terminal, as Markdown otherwise."""
        show_markdown(section)
        sys.stdout.flush()
