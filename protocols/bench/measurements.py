"""All measurements of one run of the benchmark, with derived numbers, JSON and plot."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from pathlib import Path
from statistics import median
from typing import Any

from ...controller import PROPOSERS
from ...tasks import CONTROL_TIMESTEP
from ..lives.conditions import PAPER_TASKS
from ..lives.experiment import Experiment
from .lives import BrainCost, PairedTiming, Setting
from .models import LIKE_CAR, OURS, EnvironmentCost, StepCost
from .workers import Scaling, Work

MAIN, SMALL = 250, 50  # robots in a process: the cohorts of a run, and a small cohort
PAPER, STEADY = "paper", "steady"  # names of brains
TABLE_ROBOTS = 500  # in each condition of the paper's tables


@dataclasses.dataclass(frozen=True)
class Measurements:
    """All measurements of one run of the benchmark.

    Attributes:
      lives: Paired timings: with MAIN robots for every task and proposer, with SMALL robots for
        every proposer in wall avoidance.
      sizes: Paired timings of creative wall avoidance, one for each number of robots.
      brains: Time of acting and of learning, by task and by name of the brain (creative robots).
      timers: Two median durations in [s] of a block's physics, repeated by `mujoco.rollout` alone:
        first with MuJoCo's stage timers on, then with the timers off.
      scaling: Timings of one, two and all processes, by kind of work: "live" simulates a cohort,
        "replay" repeats its physics by `mujoco.rollout` alone.
      steps: Time of a physics step, by name of the model.
      environments: Time of `env.step`, by name of the environment.
      memory: Peak memory of a process in MB, by number of robots.
    """

    lives: tuple[PairedTiming, ...]
    sizes: tuple[PairedTiming, ...]
    brains: dict[str, dict[str, BrainCost]]
    timers: tuple[float, float]
    scaling: dict[Work, Scaling]
    steps: dict[str, StepCost]
    environments: dict[str, EnvironmentCost]
    memory: dict[int, float]

    def timing(self, task: str, proposer: str, robots: int) -> PairedTiming:
        """Returns the timing of a cohort.

        Raises:
          KeyError: The cohort was not measured.
        """
        for timing in self.lives:
            setting = timing.setting
            if (setting.task, setting.proposer, setting.robots) == (task, proposer, robots):
                return timing
        raise KeyError(f"{task}, {proposer}, {robots} robots were not measured")

    def brain_ratio(self, task: str) -> float:
        """Returns the ratio of the time of the brain `steady` to that of the brain `paper`."""
        return self.brains[task][STEADY].ratio(self.brains[task][PAPER])

    @property
    def step_ratio(self) -> float:
        """Ratio of the time of our model's physics step to that of the car-like model."""
        return self.steps[OURS].ratio(self.steps[LIKE_CAR])

    @property
    def env_overhead(self) -> float:
        """Time of `env.step` outside the physics in [us], in the slower of our two tasks."""
        return max(self.environments[task].overhead_us for task in PAPER_TASKS)

    @property
    def point_mass_overhead(self) -> float:
        """Time of `env.step` outside the physics in [us], in dm_control's point_mass."""
        return self.environments["point_mass"].overhead_us

    @property
    def realtime_factor(self) -> float:
        """Robot-seconds that all processes together simulate per second of real time."""
        return self.scaling["live"].robot_steps_per_second * CONTROL_TIMESTEP

    def hours(self, task: str, proposer: str) -> float:
        """Returns the time in [h] of simulating a condition of the paper's tables on two processes.

        It assumes the speed of training for the tests, too.
        """
        seconds = self.timing(task, proposer, MAIN).microseconds["total"] * 1e-6
        return TABLE_ROBOTS * life_steps(task) * seconds / self.scaling["live"].ratio / 3600

    @property
    def tables_hours(self) -> float:
        """Time in [h] of simulating both of the paper's tables on two processes."""
        return sum(self.hours(task, proposer) for task in PAPER_TASKS for proposer in PROPOSERS)


def life_steps(task: str) -> int:
    """Returns the number of control steps in a life."""
    return sum(Experiment().schedule(task).steps())


def as_json(measured: Measurements) -> dict[str, Any]:
    """Returns the derived numbers, and all measurements under `raw`, as plain data."""
    ratios = {
        p: {str(n): measured.timing("wall_avoidance", p, n).ratio for n in (SMALL, MAIN)}
        for p in PROPOSERS
    }
    spot = {p: {str(MAIN): measured.timing("spot_finding", p, MAIN).ratio} for p in PROPOSERS}
    costs = {_name(timing.setting): timing.microseconds for timing in measured.lives}
    on, off = measured.timers
    steps = measured.steps
    raw = dataclasses.asdict(measured)
    raw["memory"] = {str(robots): peak for robots, peak in measured.memory.items()}
    return {
        "throughput_ratio": ratios,
        "throughput_ratio_spot_finding": spot,
        "robot_step_us": {name: cost["total"] for name, cost in costs.items()},
        "not_physics_us": {name: cost["brain"] + cost["rest"] for name, cost in costs.items()},
        "cost_us": {str(timing.setting.robots): timing.microseconds for timing in measured.sizes},
        "brain_us": {
            task: {name: cost.microseconds for name, cost in costs.items()}
            for task, costs in measured.brains.items()
        },
        "brain_cost_ratio": {task: measured.brain_ratio(task) for task in PAPER_TASKS},
        "timers_on_cost_ratio": on / off,
        "process_scaling": measured.scaling["live"].ratio,
        "process_scaling_bare": measured.scaling["replay"].ratio,
        "step_cost_ratio_car": measured.step_ratio,
        "step_cost_us": {name: 1e6 * median(cost.seconds) for name, cost in steps.items()},
        "step_cost_ratios": {name: cost.ratio(steps[LIKE_CAR]) for name, cost in steps.items()},
        "env_step_overhead_us": measured.env_overhead,
        "point_mass_overhead_us": measured.point_mass_overhead,
        "tables_hours_2_cores": measured.tables_hours,
        "peak_memory_mb": raw["memory"],
        "realtime_factor": measured.realtime_factor,
        "raw": raw,
    }


def _name(setting: Setting) -> str:
    return f"{setting.task}/{setting.proposer}/{setting.robots}"


def draw(sizes: Sequence[PairedTiming], path: Path) -> None:
    """Plots the time of a robot-step against the number of robots.

    Args:
      sizes: Paired timings of cohorts with different numbers of robots.
      path: File to write, an .svg, .png or .pdf.
    """
    from matplotlib.figure import Figure

    from ..pages.style import write

    robots = [timing.setting.robots for timing in sizes]
    figure = Figure(figsize=(7, 4), layout="constrained")
    axes = figure.add_subplot()
    styles = {"total": "o-k", "physics": "s-C0", "brain": "^-C1", "rest": "v-C2"}
    for part, style in styles.items():
        axes.loglog(robots, [timing.microseconds[part] for timing in sizes], style, label=part)
    axes.set_xlabel("robots in a process")
    axes.set_ylabel("\N{MICRO SIGN}s a robot-step")
    axes.set_title("Creative wall avoidance in training, one thread")
    axes.set_xticks(robots, [str(n) for n in robots])
    axes.minorticks_off()
    axes.grid(alpha=0.3)
    axes.legend()
    write(figure, path)
