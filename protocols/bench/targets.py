"""Compares the measurements with the project's targets for speed and memory."""

from __future__ import annotations

from ..lives.conditions import PAPER_TASKS
from ..pages.markdown import section
from .measurements import MAIN, PAPER, SMALL, STEADY, Measurements


def targets_section(measured: Measurements) -> str:
    """Returns a section with each target, the measured value, and whether it meets the target."""
    two, bare = measured.scaling["live"].ratio, measured.scaling["replay"].ratio
    env, point = measured.env_overhead, measured.point_mass_overhead
    ratios = [
        (proposer, robots, measured.timing("wall_avoidance", proposer, robots).ratio, least)
        for proposer, robots, least in (
            ("creative", MAIN, 0.86),
            ("creative", SMALL, 0.70),
            ("fixed", MAIN, 0.92),
            ("random", MAIN, 0.92),
        )
    ]
    targets = [
        (f"{proposer}, {robots} robots, over bare", f"{ratio:.3f}", f">= {least}", ratio >= least)
        for proposer, robots, ratio, least in ratios
    ]
    for task in PAPER_TASKS:
        name = f"acting and learning of {STEADY} over the {PAPER} brain, {task.replace('_', ' ')}"
        ratio = measured.brain_ratio(task)
        targets.append((name, f"{ratio:.2f}", "<= 2", ratio <= 2))
    targets += [
        (
            "two processes over one",
            f"{two:.3f}, bare {bare:.3f}",
            ">= 1.9, or 0.97 of bare",
            two >= 1.9 or two >= 0.97 * bare,
        ),
        (
            "a physics step over car-like",
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
    return section(
        "Targets",
        "The project's targets for speed and memory.",
        ("", "measured", "target", "met"),
        [(*cells, "yes" if met else "**no**") for *cells, met in targets],
    )
