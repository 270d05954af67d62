"""The study that chose the timestep: the same motors at several timesteps, against 1 ms.

    python -m musebot.models.convergence

prints the table of docs/physics.md.
"""

from __future__ import annotations

import dataclasses
import sys
import time

import mujoco
import numpy as np
from mujoco import rollout

from .arena import Dimensions, arena_spec

SUBSTEPS = (100, 50, 25, 20, 15, 10, 5)  # in a control step of 0.1 s; the first is the reference
_CONTROL_TIMESTEP = 0.1
_STATE = mujoco.mjtState.mjSTATE_FULLPHYSICS.value


@dataclasses.dataclass(frozen=True)
class Drive:
    """What robots did under given motors.

    Attributes:
      poses: x, y in metres and heading in radians at the end of every control step, shape
        (B, T, 3).
      gap: from the rim to the nearest wall at the instant of the last sensor reading of
        every control step, in metres, shape (B, T).
      touch: what the touch sensor read there, in newton, shape (B, T).
      deepest: the smallest gap at any substep, in metres.
      tilt: the largest, in degrees.
      microseconds: of a physics step.
    """

    poses: np.ndarray
    gap: np.ndarray
    touch: np.ndarray
    deepest: float
    tilt: float
    microseconds: float


def drive(substeps: int, motors: np.ndarray, start: tuple[float, float, float]) -> Drive:
    """Drives B robots, each alone, from one start.

    Args:
      substeps: physics steps in a control step.
      motors: values in [-0.5, 0.5], shape (B, T, 2).
      start: x, y in metres and heading in radians.
    """
    spec = arena_spec()
    spec.option.timestep = _CONTROL_TIMESTEP / substeps
    model = spec.compile()
    data = mujoco.MjData(model)
    data.qpos[[0, 1, 3, 6]] = *start[:2], np.cos(start[2] / 2), np.sin(start[2] / 2)
    first = np.empty(mujoco.mj_stateSize(model, _STATE))
    mujoco.mj_getState(model, data, first, _STATE)
    state = np.tile(first, (len(motors), 1))
    size = Dimensions.of(model)
    touch_at = int(model.sensor("touch").adr[0])
    poses, gaps, touches = [], [], []
    deepest, tilt, seconds = np.inf, 0.0, 0.0
    with rollout.Rollout(nthread=0) as engine:
        for action in motors.swapaxes(0, 1):
            control = np.repeat(action[:, None], substeps, axis=1)
            began = time.perf_counter()
            states, sensors = engine.rollout(model, data, state, control)
            seconds += time.perf_counter() - began
            states = np.concatenate([state[:, None], states], axis=1)
            state = states[:, -1].copy()
            w, i, j, k = states[..., 4:8].transpose(2, 0, 1)
            room = np.minimum(
                size.half_length - np.abs(states[..., 1]), size.half_width - np.abs(states[..., 2])
            )
            gap = room - size.radius
            deepest = min(deepest, gap.min())
            tilt = max(tilt, np.degrees(np.arccos(1 - 2 * (i * i + j * j))).max())
            heading = np.arctan2(2 * (w * k + i * j), 1 - 2 * (j * j + k * k))
            poses.append(np.stack([states[:, -1, 1], states[:, -1, 2], heading[:, -1]], axis=-1))
            gaps.append(gap[:, -2])  # sensors show the start of the last substep
            touches.append(sensors[:, -1, touch_at])
    return Drive(
        np.stack(poses, axis=1),
        np.stack(gaps, axis=1),
        np.stack(touches, axis=1),
        float(deepest),
        float(tilt),
        seconds / (motors.shape[0] * motors.shape[1] * substeps) * 1e6,
    )


def random_motors(robots: int, steps: int, *, full_speed: bool, seed: int = 0) -> np.ndarray:
    """Motor values held for 1 to 20 control steps, shape (robots, steps, 2).

    Args:
      robots: how many.
      steps: control steps.
      full_speed: -0.5 or 0.5 only; else anything between.
      seed: of the draw.
    """
    random = np.random.default_rng(seed)
    motors = np.empty((robots, steps, 2))
    for robot in range(robots):
        step = 0
        while step < steps:
            hold = int(random.integers(1, 21))
            value = random.choice([-0.5, 0.5], 2) if full_speed else random.uniform(-0.5, 0.5, 2)
            motors[robot, step : step + hold] = value
            step += hold
    return motors


def study(seeds: int = 20, minutes: float = 10.0) -> str:
    """Runs the study; returns its table as Markdown."""
    model = arena_spec().compile()
    size = Dimensions.of(model)
    steps = round(minutes * 600)
    wild = random_motors(seeds, steps, full_speed=True)
    calm = random_motors(50, 50, full_speed=False)
    straight = np.full((1, 20, 2), 0.5)
    spin = np.tile([-0.5, 0.5], (1, steps, 1))
    rest = np.zeros((1, steps, 2))
    columns = [
        "timestep, ms", "substeps", "position off after 5 s, mm", "heading off after 5 s, deg",
        "straight speed off", "spinning speed off", "drift spinning, mm", "drift at rest, mm",
        "deepest into a wall, mm", "tilt, deg", "contact is not geometry", "in contact",
        "us a step", "us a control step",
    ]  # fmt: skip
    lines = ["| " + " | ".join(columns) + " |", "|" + " ---: |" * len(columns)]
    reference = None
    for substeps in SUBSTEPS:
        free = drive(substeps, calm, (0.0, 0.0, 0.0))
        if reference is None:
            reference = free.poses[:, -1]
        off = free.poses[:, -1] - reference
        turn = np.abs((off[:, 2] + np.pi) % (2 * np.pi) - np.pi)
        fast = drive(substeps, straight, (-0.45, 0.0, 0.0)).poses[0]
        speed = (fast[-1, 0] - fast[9, 0]) / 1.0
        round_ = drive(substeps, spin, (0.0, 0.0, 0.0)).poses[0]
        rate = np.diff(np.unwrap(round_[:, 2]))[20:].mean() / _CONTROL_TIMESTEP
        still = drive(substeps, rest, (0.0, 0.0, 0.0)).poses[0]
        crash = drive(substeps, wild, (-0.425, 0.25, 3 * np.pi / 4))
        wanted = 2 * size.motor_speed / size.wheel_base
        cells = [
            f"{1e3 * _CONTROL_TIMESTEP / substeps:.3g}",
            f"{substeps}",
            f"{1e3 * np.hypot(off[:, 0], off[:, 1]).mean():.2f}",
            f"{np.degrees(turn).mean():.2f}",
            f"{speed / size.motor_speed - 1:+.2%}",
            f"{rate / wanted - 1:+.2%}",
            f"{1e3 * np.hypot(*(round_[:, :2] - round_[0, :2]).T).max():.4f}",
            f"{1e3 * np.hypot(*still[:, :2].T).max():.4f}",
            f"{max(0.0, -1e3 * crash.deepest):.2f}",
            f"{crash.tilt:.1f}",
            f"{np.mean((crash.gap <= size.contact_margin) != (crash.touch > 0)):.2%}",
            f"{np.mean(crash.touch > 0):.1%}",
            f"{crash.microseconds:.1f}",
            f"{crash.microseconds * substeps:.0f}",
        ]
        lines.append("| " + " | ".join(cells) + " |")
        print(f"{substeps} substeps done", file=sys.stderr)
    return "\n".join(lines)


if __name__ == "__main__":
    print(study())
