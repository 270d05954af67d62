"""Makes the sections of the benchmark's output, one for each kind of measurement."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from statistics import median
from typing import Any

from ..lives.conditions import PAPER_TASKS
from ..pages.markdown import section
from .lives import BrainCost, PairedTiming, Setting
from .measurements import (
    MAIN,
    PAPER,
    PROPOSERS,
    TABLE_ROBOTS,
    Measurements,
    life_steps,
)
from .models import LIKE_CAR, EnvironmentCost, StepCost
from .workers import Scaling, Work


def machine_section(machine: Mapping[str, Any]) -> str:
    """Returns a section with the versions and the processor."""
    text = "The machine of all measurements below."
    if machine["quick"]:
        text += " **Measured with --quick: too short to be quoted.**"
    rows = [(_words(name), str(value)) for name, value in machine.items()]
    return section("Machine", text, ("", "value"), rows)


def lives_section(timings: Iterable[PairedTiming]) -> str:
    """Returns a section on the throughput of every condition, compared with bare physics."""
    rows = []
    for timing in timings:
        us = timing.microseconds
        rows.append(
            (
                f"{_words(timing.setting.task)}, {timing.setting.proposer}",
                str(timing.setting.robots),
                f"{1e6 / us['total']:,.0f}",
                f"{1e6 / us['bare']:,.0f}",
                f"**{timing.ratio:.3f}**",
                f"{min(timing.ratios):.3f} to {max(timing.ratios):.3f}",
                f"{us['brain'] + us['rest']:.1f}",
            )
        )
    return section(
        "Lives against bare physics",
        "Robot-steps a second of robots in training (sensors, brain, tallies, physics), and of "
        "`mujoco.rollout` alone, which repeats their motor commands from the same states, one "
        "call a control step. One thread, in alternation, medians of blocks. The bare rollout "
        "evaluates the sensors in every substep; a life does so in the last one.",
        (
            "condition",
            "robots",
            "life, steps/s",
            "bare, steps/s",
            "ratio",
            "range of blocks",
            "outside physics, us a robot-step",
        ),
        rows,
    )


def sizes_section(timings: Iterable[PairedTiming]) -> str:
    """Returns a section on the time of a robot-step for every number of robots."""
    rows = []
    for timing in timings:
        us = timing.microseconds
        cells = (f"{us[part]:.1f}" for part in ("total", "physics", "brain", "rest", "bare"))
        rows.append((str(timing.setting.robots), *cells, f"{timing.ratio:.3f}"))
    return section(
        "Cost against the number of robots",
        "Microseconds a robot-step of creative wall avoidance in one process. Physics is MuJoCo. "
        "Brain is acting and learning. Rest is sensors, rewards, tallies and the copying between "
        "them. Ratio is the median of bare over total.",
        ("robots", "total", "physics", "brain", "rest", "bare", "ratio"),
        rows,
    )


def brains_section(brains: Mapping[str, Mapping[str, BrainCost]]) -> str:
    """Returns a section on the time of the brains `steady` and `paper`."""
    rows = []
    for task, costs in brains.items():
        for name, cost in costs.items():
            numbers = cost.microseconds, cost.ratio(costs[PAPER]), cost.share
            cells = (f"{x:{form}}" for x, form in zip(numbers, (".1f", ".2f", ".3f"), strict=True))
            rows.append((f"{_words(task)}, {name}", *cells))
    return section(
        "Two brains",
        f"Time of acting and learning of {MAIN} creative robots in one process, with the paper's "
        "brain and with ours, in alternation, medians of blocks.",
        (
            "task and brain",
            "brain, us a robot-step",
            "relative to the paper's",
            "share of the time",
        ),
        rows,
    )


def timers_section(timers: tuple[float, float], setting: Setting) -> str:
    """Returns a section on the time that MuJoCo's stage timers cost."""
    on, off = (1e6 * seconds / setting.robot_steps for seconds in timers)
    return section(
        "MuJoCo's timers",
        "A bare rollout in two processes in alternation: one with MuJoCo's stage timers on, which "
        "is MuJoCo's default, and one with them off, as in all other measurements.",
        ("timers", "bare, steps/s", "us a robot-step"),
        (("on", f"{1e6 / on:,.0f}", f"{on:.1f}"), ("off", f"{1e6 / off:,.0f}", f"{off:.1f}")),
    )


def scaling_section(scaling: Mapping[Work, Scaling]) -> str:
    """Returns a section on the throughput of one, two and all processes."""
    names: dict[Work, str] = {"live": "lives", "replay": "bare rollout"}
    rows = []
    for work, name in names.items():
        times = scaling[work]
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
    return section(
        "Processes",
        f"Robot-steps a second of creative wall avoidance, {MAIN} robots in each process: one "
        "process, two at the same time, and as many as there are cores, in alternation.",
        ("", "one", "two", "two over one", f"all {scaling['live'].processes}"),
        rows,
    )


def steps_section(steps: Mapping[str, StepCost]) -> str:
    """Returns a section on the time of a physics step of every model."""
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
                f"**{cost.ratio(steps[LIKE_CAR]):.3f}**",
            )
        )
    return section(
        "A physics step compared with a car's",
        "`mj_step` of our robot in its arena, and of a free two-wheeled car with as many degrees "
        "of freedom (our own, with the structure of MuJoCo's `model/car/car.xml`; that file too, "
        "where it was found). Random controls every 0.1 s, in alternation, timers off.",
        (
            "model",
            "degrees of freedom",
            "geoms",
            "sensors",
            "contacts, mean",
            "constraint rows, mean",
            "timestep, ms",
            "us a step",
            "relative to car-like",
        ),
        rows,
    )


def environments_section(costs: Iterable[EnvironmentCost]) -> str:
    """Returns a section on the time of `env.step` outside the physics."""
    rows = [
        (
            cost.name if cost.name == "point_mass" else _words(cost.name),
            str(cost.substeps),
            f"{1e6 * median(cost.step):.1f}",
            f"{1e6 * median(cost.bare):.1f}",
            f"**{cost.overhead_us:.1f}**",
        )
        for cost in costs
    ]
    return section(
        "A step of the environment",
        "`env.step` of our dm_control tasks and of dm_control's point_mass, and the same physics "
        "steps alone, from the same states, in alternation, in microseconds.",
        ("environment", "physics steps", "env.step", "its physics steps", "difference"),
        rows,
    )


def memory_section(memory: Mapping[int, float]) -> str:
    """Returns a section on the peak memory of a process."""
    return section(
        "Memory",
        "Peak of a new process that simulates creative wall avoidance for a short time and saves "
        "a checkpoint, in MB (10^6 bytes).",
        ("robots", "peak, MB"),
        [(str(robots), f"{peak:.0f}") for robots, peak in memory.items()],
    )


def hours_section(measured: Measurements) -> str:
    """Returns a section on the time of simulating the paper's tables."""
    rows = [
        (
            f"{_words(task)}, {proposer}",
            f"{life_steps(task):,}",
            f"{measured.timing(task, proposer, MAIN).microseconds['total']:.1f}",
            f"{measured.hours(task, proposer):.2f}",
        )
        for task in PAPER_TASKS
        for proposer in PROPOSERS
    ]
    rows.append(("both tables", "", "", f"**{measured.tables_hours:.2f}**"))
    return section(
        "The paper's tables",
        f"Hours with two processes of {MAIN} robots for {TABLE_ROBOTS} robots in each of the six "
        "conditions. The rate is that of training; tests are cheaper. All cores together "
        f"simulate {measured.realtime_factor:,.0f} robot-seconds a second (creative wall "
        "avoidance).",
        ("condition", "control steps a life", "us a robot-step", "hours"),
        rows,
    )


def _words(name: str) -> str:
    return name.replace("_", " ")
