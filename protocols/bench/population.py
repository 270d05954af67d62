"""Times populations of robots on a device, in the kinematic simulator and in MuJoCo Warp."""

from __future__ import annotations

import dataclasses
import gc
import re
import time
from collections.abc import Callable, Sequence
from typing import Any

import torch

from ...tasks.tensors.robots import TensorRobots
from ..lives.cohort import Cohort
from ..lives.conditions import CohortKey, Condition
from ..lives.experiment import Experiment
from ..lives.plan import Plan
from ..lives.runs import check_device as check_plan
from ..pages import markdown
from .lives import begin_training

CONDITION = Condition("spot_finding", "creative")
WORLDS = {"kinematic": {"body": "kinematic"}, "C MuJoCo": {}, "MuJoCo Warp": {"physics": "warp"}}
_CPU, _GPU = (50, 250, 1000), (250, 1024, 4096, 16_384, 65_536, 262_144)
# Control steps between two looks at the clock. A life copies its tally to the host once a block, in
# `musebot run` once in 600 steps.
_CPU_BLOCK, _GPU_BLOCK = 5, 300
_PROFILED = 100  # control steps
# PyTorch's and Warp's sentences.
_OUT_OF_MEMORY = re.compile("out of memory|Failed to allocate")
_TRANSFERS = ("Memcpy HtoD", "Memcpy DtoH")  # in PyTorch's profile of a GPU


@dataclasses.dataclass(frozen=True)
class Rate:
    """Speed of a population of creative robots in training.

    Attributes:
      robots: Number of robots.
      physics: Robot-steps a second of the physics alone, by world; None where memory is too small.
      life: Robot-steps a second with sensors, brain and tallies, by world; None as above.
      kernels: Kernels that a control step of a life launches on a GPU, by world.
      transfers: Copies between GPU and host in a control step, by world.
      longest: Names of the three operations that take the most time, by world.
    """

    robots: int
    physics: dict[str, float | None]
    life: dict[str, float | None]
    kernels: dict[str, float]
    transfers: dict[str, float]
    longest: dict[str, list[str]]


def check_device(device: str) -> None:
    """Raises InputError where a device is missing, or MuJoCo Warp is not installed."""
    for world in worlds(device):
        check_plan(Plan.of(_experiment(world, device, 1), [CONDITION], 1))


def worlds(device: str) -> list[str]:
    """Returns the names of the simulators that a device has."""
    return [name for name in WORLDS if device == "cpu" or name != "C MuJoCo"]


def sizes(device: str, quick: bool) -> tuple[int, ...]:
    """Returns the numbers of robots that are measured on a device."""
    return (4,) if quick else _CPU if device == "cpu" else _GPU


def measure(device: str, robots: int, seconds: float) -> Rate:
    """Times a population on a device.

    Args:
      device: Device, as PyTorch names it.
      robots: Number of robots.
      seconds: Time in [s] for which each number is measured.
    """
    rate = Rate(robots, {}, {}, {}, {}, {})
    for world in worlds(device):
        rate.physics[world] = rate.life[world] = None
        try:
            _measure(rate, world, device, seconds)
        except RuntimeError as error:
            if not _OUT_OF_MEMORY.search(str(error)):
                raise
        if device != "cpu":  # the next world needs the memory of this one
            gc.collect()
            torch.cuda.empty_cache()
    return rate


def _measure(rate: Rate, world: str, device: str, seconds: float) -> None:
    """Adds the numbers of a world to a rate."""
    robots = rate.robots
    cohort = Cohort(_experiment(world, device, robots), CohortKey(CONDITION, 0))
    begin_training(cohort, CONDITION.task)
    block = _CPU_BLOCK if device == "cpu" else _GPU_BLOCK
    rate.life[world] = robots * _steps_a_second(cohort.advance, block, device, seconds)
    if device != "cpu":
        found = _profile(cohort, device)
        rate.kernels[world], rate.transfers[world], rate.longest[world] = found
    batch: Any = cohort.batch
    motors = torch.rand(robots, 2, device=device) - 0.5
    given = motors if isinstance(batch, TensorRobots) else motors.numpy()

    def simulate(steps: int) -> None:
        for _ in range(steps):
            batch.step(given)

    rate.physics[world] = robots * _steps_a_second(simulate, block, device, seconds)


def section(device: str, rates: Sequence[Rate]) -> str:
    """Returns the section on populations."""
    shown = worlds(device)
    rows = [
        (f"{rate.robots:,}", *(cell for world in shown for cell in _cells(rate, world, device)))
        for rate in rates
    ]
    longest = "; ".join(f"{w}: {', '.join(names)}" for w, names in rates[-1].longest.items())
    head = ("physics", "life") if device == "cpu" else ("physics", "life", "kernels", "copies")
    return markdown.section(
        f"Populations on {device}",
        "Robot-steps a second of creative spot finding in training: the physics alone, and lives "
        "with sensors, the paper's brain and tallies. On a GPU also the kernels that a control "
        "step of a life launches, and its copies between GPU and host, by PyTorch's profiler. "
        + (f"Longest kernels with the most robots: {longest}." if longest else ""),
        ("robots", *(f"{world}: {name}" for world in shown for name in head)),
        rows,
    )


def _cells(rate: Rate, world: str, device: str) -> list[str]:
    speeds = (rate.physics[world], rate.life[world])
    counts = (rate.kernels.get(world), rate.transfers.get(world))
    cells = ["out of memory" if speed is None else f"{speed:,.0f}" for speed in speeds]
    if device != "cpu":
        cells += ["" if count is None else f"{count:,.1f}" for count in counts]
    return cells


def _experiment(world: str, device: str, robots: int) -> Experiment:
    settings: Any = WORLDS[world]
    return Experiment(cohort_size=robots, device=device, **settings)


def _steps_a_second(
    simulate: Callable[[int], None], block: int, device: str, seconds: float
) -> float:
    """Returns how many control steps `simulate` takes in a second, in blocks of so many steps."""
    simulate(block)
    _wait(device)
    began, steps = time.perf_counter(), 0
    while (passed := time.perf_counter() - began) < seconds or not steps:
        simulate(block)
        _wait(device)
        steps += block
    return steps / passed


def _profile(cohort: Cohort, device: str) -> tuple[float, float, list[str]]:
    """Returns numbers of kernels and transfers in a control step, and the longest operations."""
    from torch.profiler import ProfilerActivity, profile

    cohort.advance(_PROFILED)  # captures what can be captured
    _wait(device)
    with profile(activities=[ProfilerActivity.CPU, ProfilerActivity.CUDA]) as profiled:
        cohort.advance(_PROFILED)
        _wait(device)
    # Operations of the host have their kernels' time, too.
    events = [e for e in profiled.key_averages() if e.device_type.name == "CUDA"]
    events.sort(key=lambda e: e.self_device_time_total, reverse=True)
    kernels = sum(e.count for e in events if not e.key.startswith("Mem")) / _PROFILED
    transfers = sum(e.count for e in events if e.key.startswith(_TRANSFERS)) / _PROFILED
    return kernels, transfers, [e.key[:60] for e in events[:3]]


def _wait(device: str) -> None:
    if device != "cpu":
        torch.cuda.synchronize(device)
