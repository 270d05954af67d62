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

from ...models.arena import Dimensions, arena_spec, robot_pose, robot_qpos

SUBSTEPS = (100, 50, 25, 20, 15, 14, 10, 5)  # in a control step of 0.1 s; first the reference
_CONTROL_TIMESTEP = 0.1
_CENTRE = (0.0, 0.0, 0.0)
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
    data.qpos[:] = robot_qpos(np.array(start))
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
            gap = _gap(states, size)
            deepest = min(deepest, gap.min())
            tilt = max(tilt, _tilt(states).max())
            poses.append(robot_pose(state[:, 1:]))
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


def _gap(states: np.ndarray, size: Dimensions) -> np.ndarray:
    """From the rim to the nearest wall, in metres, shape (...), of states (..., n)."""
    x, y = np.abs(states[..., 1]), np.abs(states[..., 2])
    return np.minimum(size.half_length - x, size.half_width - y) - size.radius


def _tilt(states: np.ndarray) -> np.ndarray:
    """In degrees, shape (...), of states (..., n)."""
    i, j = states[..., 5], states[..., 6]
    return np.degrees(np.arccos(1 - 2 * (i * i + j * j)))


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
    size = Dimensions.of(arena_spec().compile())
    steps = round(minutes * 600)
    wild = random_motors(seeds, steps, full_speed=True)
    calm = random_motors(50, 50, full_speed=False)
    rows, reference = [], None
    for substeps in SUBSTEPS:
        free = drive(substeps, calm, _CENTRE).poses[:, -1]
        fast = drive(substeps, np.full((1, 20, 2), 0.5), (-0.45, 0.0, 0.0)).poses[0]
        spin = drive(substeps, np.tile([-0.5, 0.5], (1, steps, 1)), _CENTRE).poses[0]
        rest = drive(substeps, np.zeros((1, steps, 2)), _CENTRE).poses[0]
        reference = free if reference is None else reference
        crash = drive(substeps, wild, (-0.425, 0.25, 3 * np.pi / 4))
        rows.append(
            {
                "timestep, ms": f"{1e3 * _CONTROL_TIMESTEP / substeps:.3g}",
                "substeps": f"{substeps}",
                **_accuracy(free - reference),
                **_speeds(fast, spin, size),
                **_drifts(spin, rest),
                **_contacts(crash, size),
                "us a step": f"{crash.microseconds:.1f}",
                "us a control step": f"{crash.microseconds * substeps:.0f}",
            }
        )
        print(f"{substeps} substeps done", file=sys.stderr)
    lines = ["| " + " | ".join(cells) + " |" for cells in (rows[0], *map(dict.values, rows))]
    return "\n".join([lines[0], "|" + " ---: |" * len(rows[0]), *lines[1:]])


def _accuracy(off: np.ndarray) -> dict[str, str]:
    """How far from the reference robots are, by differences of poses, shape (B, 3)."""
    turn = np.abs((off[:, 2] + np.pi) % (2 * np.pi) - np.pi)
    return {
        "position off after 5 s, mm": f"{1e3 * np.hypot(off[:, 0], off[:, 1]).mean():.2f}",
        "heading off after 5 s, deg": f"{np.degrees(turn).mean():.2f}",
    }


def _speeds(fast: np.ndarray, spin: np.ndarray, size: Dimensions) -> dict[str, str]:
    """Straight ahead and on the spot, against what was commanded; poses of shape (T, 3)."""
    speed = (fast[-1, 0] - fast[9, 0]) / 1.0
    rate = np.diff(np.unwrap(spin[:, 2]))[20:].mean() / _CONTROL_TIMESTEP
    wanted = 2 * size.motor_speed / size.wheel_base
    return {
        "straight speed off": f"{speed / size.motor_speed - 1:+.2%}",
        "spinning speed off": f"{rate / wanted - 1:+.2%}",
    }


def _drifts(spin: np.ndarray, rest: np.ndarray) -> dict[str, str]:
    """How far robots come that should stay where they are; poses of shape (T, 3)."""
    return {
        "drift spinning, mm": f"{1e3 * np.hypot(*(spin[:, :2] - spin[0, :2]).T).max():.4f}",
        "drift at rest, mm": f"{1e3 * np.hypot(*rest[:, :2].T).max():.4f}",
    }


def _contacts(crash: Drive, size: Dimensions) -> dict[str, str]:
    """What walls do to robots that ram them."""
    touching = crash.touch > 0
    return {
        "deepest into a wall, mm": f"{max(0.0, -1e3 * crash.deepest):.2f}",
        "tilt, deg": f"{crash.tilt:.1f}",
        "contact is not geometry": f"{np.mean((crash.gap <= size.contact_margin) != touching):.2%}",
        "in contact": f"{np.mean(touching):.1%}",
    }


if __name__ == "__main__":
    print(study())
