"""Checks of what a run's files hold, against the experiment and against each other."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np

from ...tasks.arena import CONTROL_TIMESTEP
from ..storage import DTYPES, Shapes
from .agent import network_shapes
from .conditions import CohortKey, Condition
from .learn_ability import INVALID, learn_ability
from .results import WHEN, Lives, NetworkArrays, Robot, When, category_in
from .schedules import PARTS, Part, Schedule, control_steps

if TYPE_CHECKING:
    from .experiment import Experiment
    from .plan import Plan

_TOLERANCE = 1e-9  # of Learn Ability: files of earlier versions were computed elsewhere


def check_rows(plan: Plan, condition: Condition, rows: Mapping[int, Robot]) -> None:
    """Checks the rows of a condition against the plan and against each other.

    Args:
      plan: Plan of the run; a run that is being enlarged has fewer robots.
      condition: Condition of the rows.
      rows: Rows of robots.csv by row number, in the order of the file.

    Raises:
      ValueError: a value contradicts the plan or another value; the text names row and column.
    """
    size, seed = plan.experiment.cohort_size, plan.experiment.seed
    planned, schedule = plan.robots.get(condition, 0), plan.experiment.schedule(condition.task)
    numbers, robots = [*rows], [*rows.values()]
    if len(robots) > planned or len(robots) % size:
        raise ValueError(
            f"row {numbers[-1]}: the robots of {condition} must be whole cohorts of {size}, at "
            f"most {planned}, got {len(robots)}"
        )

    def check(column: str, sound: Sequence[bool] | np.ndarray, must: Callable[[int], str]) -> None:
        wrong = np.flatnonzero(~np.array(sound))
        if len(wrong):
            value = getattr(robots[wrong[0]], column)
            raise ValueError(
                f"row {numbers[wrong[0]]}, column {column}: must {must(wrong[0])}, got {value!r}"
            )

    check("seed", [row.seed == seed for row in robots], lambda i: f"be {seed}")
    check("robot", [row.robot == i for i, row in enumerate(robots)], lambda i: f"be {i}")
    check(
        "cohort", [row.cohort == row.robot // size for row in robots], lambda i: f"be {i // size}"
    )
    tests: tuple[tuple[str, Part], ...] = (("t_pre_s", "pre"), ("t_post_s", "post"))
    times = []
    for column, part in tests:
        most = round(schedule.steps_of(part) * CONTROL_TIMESTEP, 1)
        seconds = np.array([getattr(row, column) for row in robots])
        in_range = (seconds >= 0) & (seconds <= most)
        check(column, in_range, lambda i, most=most: f"lie in [0, {most}]")
        whole = [time == round(time, 1) for time in seconds.tolist()]
        check(column, whole, lambda i: "be a multiple of 0.1")
        times.append(_steps(seconds) * CONTROL_TIMESTEP)
    valid = np.array([row.valid for row in robots])
    abilities = learn_ability(times[0], times[1], schedule.wanted)
    expected = np.where(valid, abilities, np.nan)
    found = np.array([row.learn_ability for row in robots])
    equal = np.isclose(found, expected, rtol=0, atol=_TOLERANCE, equal_nan=True)
    check("learn_ability", equal, lambda i: f"be {expected[i]} by the row's other cells")
    names = [
        category_in(condition.task, ability) if sound else INVALID
        for ability, sound in zip(expected.tolist(), valid, strict=True)
    ]
    same = [row.category == name for row, name in zip(robots, names, strict=True)]
    check("category", same, lambda i: f"be {names[i]!r} by the row's times")


def _steps(seconds: Sequence[float] | np.ndarray) -> np.ndarray:
    return np.rint(np.array(seconds) / CONTROL_TIMESTEP).astype(int)


def check_curves(schedule: Schedule, curves: np.ndarray, rows: Sequence[Robot]) -> None:
    """Checks that curves are shares, and that they agree with the times of their robots.

    Args:
      schedule: Schedule of the robots.
      curves: Share of each minute with the event, one row for each of `rows`, shape (n, M).
      rows: Rows of robots.csv.

    Raises:
      ValueError: a value is no share, or the minutes of a test contradict its time.
    """
    # A comparison with NaN is false.
    wrong = np.argwhere(~((curves >= 0) & (curves <= 1)))
    if len(wrong):
        robot, minute = wrong[0]
        value = curves[robot, minute]
        raise ValueError(f"row {robot}, minute {minute}: must lie in [0, 1], got {value}")
    counts = np.rint(curves.astype(float) * schedule.steps_of_minutes()).astype(int)
    tests: tuple[tuple[Part, np.ndarray], ...] = (
        ("pre", _steps([row.t_pre_s for row in rows])),
        ("post", _steps([row.t_post_s for row in rows])),
    )
    for part, times in tests:
        least, most = (
            counts[:, minutes].sum(axis=1) for minutes in _minutes_within(schedule, part)
        )
        wrong = np.flatnonzero((times < least) | (times > most))
        if len(wrong):
            robot = wrong[0]
            time, own = times[robot] * CONTROL_TIMESTEP, most[robot] * CONTROL_TIMESTEP
            raise ValueError(
                f"row {robot}: the minutes of the test sum to {own:.1f} s, but robots.csv has "
                f"{time:.1f} s {schedule.event} (t_{part}_s)"
            )


def _minutes_within(schedule: Schedule, part: Part) -> tuple[slice, slice]:
    """Returns the minutes that lie within a part, and those that it touches."""
    touched = schedule.minutes_of(part)
    first = sum(schedule.steps_of(before) for before in PARTS[: PARTS.index(part)])
    last, minute = first + schedule.steps_of(part), control_steps(1)
    end = touched.stop if part == PARTS[-1] else last // minute
    return slice(-(-first // minute), end), touched


def check_network_shapes(
    experiment: Experiment, condition: Condition, shapes: Shapes, most: int
) -> None:
    """Checks names, dtypes and shapes of a condition's networks before they are read.

    Args:
      experiment: Experiment of the robots.
      condition: Condition of the robots.
      shapes: Arrays by "before|after/network.tensor".
      most: Largest number of robots.

    Raises:
      ValueError: an array is missing, foreign, or of another dtype or shape.
    """
    own = network_shapes(experiment, condition)
    if own is None:  # an agent of a user's: whatever it has before training it has after it
        named = {w: {n[len(w) + 1 :]: s for n, s in shapes.items() if n.startswith(f"{w}/")}
                 for w in WHEN}  # fmt: skip
        if named["before"] != named["after"]:
            raise ValueError(f"{condition} has other networks before training than after it")
        wanted = {name: shape[1:] for name, (_, shape) in shapes.items() if shape}
    else:
        wanted = {f"{when}/{name}": shape for when in WHEN for name, shape in own.items()}
    for name in sorted({*wanted, *shapes}):
        if name not in shapes:
            raise ValueError(f"{condition}/{name} is missing")
        dtype, shape = shapes[name]
        if name not in wanted or name.partition("/")[0] not in WHEN:
            raise ValueError(f"{condition} has no network {name}")
        if dtype != "F32" and (own is not None or dtype not in DTYPES.values()):
            raise ValueError(f"{condition}/{name} must be of dtype F32, got {dtype}")
        if shape[1:] != wanted[name] or shape[0] > most:
            text = ", ".join(map(str, wanted[name]))
            raise ValueError(
                f"{condition}/{name} must have shape (N, {text}) with N up to {most}, got {shape}"
            )
    if len({shape[0] for _, shape in shapes.values()}) > 1:
        raise ValueError(f"the networks of {condition} have different numbers of robots")


def check_networks(
    experiment: Experiment,
    condition: Condition,
    networks: Mapping[When, NetworkArrays],
    valid: np.ndarray,
) -> None:
    """Checks that the weights of valid robots are finite, and those of both networks as drawn.

    Args:
      experiment: Experiment of the robots.
      condition: Condition of the robots.
      networks: Networks "before" and "after" training, each of shape (N, ...).
      valid: False for a robot whose weights may be anything, shape (N,).

    Raises:
      ValueError: a weight is not finite, or too large at birth; the text names the first.
    """
    largest = np.float32(experiment.brain.initial_range) * (1 + 1e-6)
    for when, arrays in networks.items():
        for name, array in arrays.items():
            sound = np.isfinite(array)
            drawn = when == "before" and condition.has_brain and _is_drawn(name)
            if drawn:
                sound &= np.abs(array) <= largest
            broken = ~sound.reshape(len(array), -1).all(axis=1) & valid
            if broken.any():
                must = "finite"
                if drawn:
                    must = f"finite and within [-{largest:g}, {largest:g}]"
                robot = np.flatnonzero(broken)[0]
                raise ValueError(f"{condition}/{when}/{name}, row {robot}: must be {must}")


def _is_drawn(name: str) -> bool:
    """Returns whether a newborn's array of a brain is drawn from `initial_range`."""
    return name.startswith(("evaluation.", "memory."))


def check_lives_shapes(experiment: Experiment, key: CohortKey, shapes: Shapes) -> None:
    """Checks names, dtypes and shapes in a finished cohort's file before any array is read.

    Raises:
      ValueError: an array is missing, foreign, or of another dtype or shape.
    """
    robots, condition = experiment.cohort_size, key.condition
    minutes = len(experiment.schedule(condition.task).steps_of_minutes())
    counts: Shapes = {
        "events": ("I32", (robots, len(PARTS))),
        "minutes": ("I16", (robots, minutes)),
        "valid": ("BOOL", (robots,)),
    }
    check_same_shapes(counts, {name: shapes[name] for name in counts if name in shapes})
    networks = {name: shape for name, shape in shapes.items() if name not in counts}
    if networks or condition.has_brain:
        check_network_shapes(experiment, condition, networks, robots)
    for name, (_, shape) in networks.items():
        if shape[0] != robots:
            raise ValueError(f"{name} must be of {robots} robots, got {shape[0]}")


def check_same_shapes(wanted: Shapes, found: Shapes) -> None:
    """Raises ValueError where arrays are missing or foreign, or differ in dtype or shape."""
    for name in sorted({*wanted, *found}):
        if name not in found:
            raise ValueError(f"{name} is missing")
        if name not in wanted:
            raise ValueError(f"{name} is no array of it")
        if found[name] != wanted[name]:
            (dtype, shape), (own, size) = wanted[name], found[name]
            raise ValueError(f"{name} must be {dtype} of shape {shape}, got {own} of shape {size}")


def check_lives(experiment: Experiment, key: CohortKey, lives: Lives) -> None:
    """Checks the values that a finished cohort left; `check_lives_shapes` comes first.

    Raises:
      ValueError: a value is impossible.
    """
    schedule = experiment.schedule(key.condition.task)
    check_events(schedule, lives.events, lives.minutes, sum(schedule.steps()))
    networks: dict[When, NetworkArrays] = {"before": lives.before, "after": lives.after}
    check_networks(experiment, key.condition, networks, lives.valid)


def check_events(schedule: Schedule, events: np.ndarray, minutes: np.ndarray, step: int) -> None:
    """Checks the counts of events of robots up to a control step.

    Args:
      schedule: Schedule of the robots.
      events: Control steps with the event in each part of the life, shape (B, 3).
      minutes: Control steps with the event in each minute, shape (B, M).
      step: Number of control steps simulated.

    Raises:
      ValueError: a count is impossible.
    """
    done = np.array([schedule.steps_of(part) for part in PARTS])
    within = np.clip(step - np.concatenate([[0], done.cumsum()[:-1]]), 0, done)
    whole = schedule.steps_of_minutes()
    of_minutes = np.clip(step - np.arange(len(whole)) * control_steps(1), 0, whole)
    for name, counts, most in (("events", events, within), ("minutes", minutes, of_minutes)):
        wrong = np.argwhere((counts < 0) | (counts > most))
        if len(wrong):
            robot, column = wrong[0]
            raise ValueError(
                f"{name}, row {robot}, column {column}: must lie in [0, {most[column]}], "
                f"got {counts[robot, column]}"
            )
    apart = np.flatnonzero(events.sum(axis=1) != minutes.sum(axis=1))
    if len(apart):
        raise ValueError(f"row {apart[0]}: its events and its minutes have different sums")
