"""The study of the timestep: the same motor values at several timesteps (docs/physics.md)."""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, ClassVar

import mujoco
import numpy as np
from mujoco import rollout

from ...models.arena import Dimensions, arena_spec, robot_pose, robot_qpos
from ...tasks import CONTROL_TIMESTEP
from ..errors import DamagedFileError, InputError
from ..experiment.experiment import Experiment
from ..reporting.markdown import table
from ..simulation.jobs import Job, Report, Stop
from ..storage import Shapes
from .jobs import FileJob, StoppedError
from .study import Page, Study, check_positive

SUBSTEPS = (100, 50, 25, 20, 15, 14, 10, 5)  # in a control step; the first is the reference

_CALM_ROBOTS, _CALM_STEPS, _FAST_STEPS = 50, 50, 20
_MOST_MINUTES = 20_000  # of all robots; half a gigabyte of poses
_NUMBERS = ("deepest", "tilt", "differing", "touching", "microseconds")
_CENTRE = (0.0, 0.0, 0.0)
_STATE = mujoco.mjtState.mjSTATE_FULLPHYSICS.value


@dataclasses.dataclass
class Timestep(Study):
    """Measure how the body's motion converges with the physics timestep.

    Drives robots with the same motor values at eight timesteps, and compares their motion with that
    at the smallest one. The page also reports the speed of the simulation; it is accurate only on
    an idle machine with --processes 1.
    """

    name: ClassVar[str] = "timestep"

    robots: int = 20
    """number of robots that drive into walls"""
    minutes: float = 10.0
    """simulated minutes of driving"""

    def experiments(self) -> Mapping[str, Experiment]:
        """See `Study.experiments`: there are none."""
        check_positive(robots=self.robots)
        if not 0.05 <= self.minutes < np.inf:
            raise InputError(f"minutes must be at least 0.05, got {self.minutes}")
        if (total := self.robots * self.minutes) > _MOST_MINUTES:
            raise InputError(
                f"robots times minutes must be at most {_MOST_MINUTES}, got {total:g}: every pose "
                "is kept in memory"
            )
        return {}

    def details(self) -> Mapping[str, Any]:
        """See `Study.details`."""
        return {"robots": self.robots, "minutes": self.minutes}

    def check(self, out: Path) -> None:
        """See `Study.check`."""
        for job in self._jobs(out):
            if job.done():
                job.measured()

    def stages(self, out: Path) -> Iterator[Sequence[Job]]:
        """See `Study.stages`: a job for each timestep."""
        yield self._jobs(out)

    def page(self, out: Path) -> Page:
        """See `Study.page`."""
        found = []
        for job in self._jobs(out):
            if not job.done():
                raise InputError(f"{out} lacks {job.path.name}")
            found.append((job.substeps, job.measured()))
        return Page(markdown(found))

    def _jobs(self, out: Path) -> list[TimestepJob]:
        return [
            TimestepJob(out / f"substeps-{n:03d}.safetensors", n, self.robots, self.minutes)
            for n in SUBSTEPS
        ]


@dataclasses.dataclass(frozen=True)
class TimestepJob(FileJob):
    """Measures the robots' motion at one timestep.

    Attributes:
      path: File to which the measurements are written.
      substeps: Number of physics steps in a control step.
      robots: Number of robots that drive randomly, also into walls.
      minutes: Simulated minutes of each long drive.
    """

    path: Path
    substeps: int
    robots: int
    minutes: float

    def __str__(self) -> str:
        return f"{self.substeps} substeps"

    @property
    def steps(self) -> int:
        """Number of control steps of the long drives."""
        return round(self.minutes * 600)

    @property
    def cost(self) -> float:
        """See `Job.cost`."""
        steps = _CALM_ROBOTS * _CALM_STEPS + _FAST_STEPS + (self.robots + 2) * self.steps
        return steps * CONTROL_TIMESTEP

    @property
    def identity(self) -> dict[str, Any]:
        """See `FileJob.identity`."""
        return {"substeps": self.substeps, "robots": self.robots, "minutes": self.minutes}

    def measured(self) -> dict[str, np.ndarray]:
        """Reads the measurements.

        Raises:
          DamagedFileError: the file is damaged, or another job's.
        """
        steps = {"calm": _CALM_ROBOTS, "spin": self.steps, "rest": self.steps, "fast": _FAST_STEPS}
        shapes: Shapes = {name: ("F64", (count, 3)) for name, count in steps.items()}
        arrays = self.read(shapes | {n: ("F64", ()) for n in _NUMBERS})
        for name, array in arrays.items():
            if not np.isfinite(array).all():
                raise DamagedFileError(f"{self.path} is damaged ({name} is not finite)")
        return arrays

    def work(self, stop: Stop, report: Report) -> dict[str, np.ndarray]:
        """See `FileJob.work`."""
        done = 0.0

        def driven(motors: np.ndarray, start: tuple[float, float, float]) -> Motion:
            nonlocal done
            motion = drive(self.substeps, motors, start, stop)
            done += motors.shape[0] * motors.shape[1] * CONTROL_TIMESTEP
            report(done, "")
            return motion

        calm = random_motors(_CALM_ROBOTS, _CALM_STEPS, full_speed=False)
        wild = random_motors(self.robots, self.steps, full_speed=True)
        crash = driven(wild, (-0.425, 0.25, 3 * np.pi / 4))
        spin = driven(np.tile([-0.5, 0.5], (1, self.steps, 1)), _CENTRE)
        rest = driven(np.zeros((1, self.steps, 2)), _CENTRE)
        fast = driven(np.full((1, _FAST_STEPS, 2), 0.5), (-0.45, 0.0, 0.0))
        size = Dimensions.of(arena_spec().compile())
        touching = crash.touch > 0
        numbers = {
            "deepest": crash.deepest,
            "tilt": crash.tilt,
            "differing": np.mean((crash.gap <= size.contact_margin) != touching),
            "touching": np.mean(touching),
            "microseconds": crash.microseconds,
        }
        return {
            "calm": driven(calm, _CENTRE).poses[:, -1],
            "spin": spin.poses[0],
            "rest": rest.poses[0],
            "fast": fast.poses[0],
            **{name: np.array(number, dtype=float) for name, number in numbers.items()},
        }


@dataclasses.dataclass(frozen=True)
class Motion:
    """Motion of B robots in T control steps with given motor values.

    Attributes:
      poses: x, y in [m] and heading in [rad] at the end of every control step, shape (B, T, 3).
      gap: Distance in [m] from the robot's rim to the nearest wall, at the last sensor reading of
        every control step, shape (B, T).
      touch: Force in [N] at the touch sensor, at the last sensor reading of every control step,
        shape (B, T).
      deepest: Smallest distance in [m] from the rim to a wall over all robots and substeps.
      tilt: Largest tilt in degrees over all robots and substeps.
      microseconds: Computing time in [us] of a physics step of one robot.
    """

    poses: np.ndarray
    gap: np.ndarray
    touch: np.ndarray
    deepest: float
    tilt: float
    microseconds: float


def drive(
    substeps: int,
    motors: np.ndarray,
    start: tuple[float, float, float],
    stop: Stop = lambda: False,
) -> Motion:
    """Drives B robots, each alone in its arena, from the same start pose.

    Args:
      substeps: Number of physics steps in a control step.
      motors: Motor values in [-0.5, 0.5], left motor first, shape (B, T, 2).
      start: x, y in [m] and heading in [rad] of the start pose.
      stop: Function that returns whether to stop; called every simulated minute.

    Raises:
      StoppedError: `stop` returned True.
    """
    spec = arena_spec()
    spec.option.timestep = CONTROL_TIMESTEP / substeps
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
        for step, action in enumerate(motors.swapaxes(0, 1)):
            if step % 600 == 0 and stop():
                raise StoppedError
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
    return Motion(
        np.stack(poses, axis=1),
        np.stack(gaps, axis=1),
        np.stack(touches, axis=1),
        float(deepest),
        float(tilt),
        seconds / (motors.shape[0] * motors.shape[1] * substeps) * 1e6,
    )


def _gap(states: np.ndarray, size: Dimensions) -> np.ndarray:
    """Returns the distance from the rim to the nearest wall in [m], for states (..., n)."""
    x, y = np.abs(states[..., 1]), np.abs(states[..., 2])
    return np.minimum(size.half_length - x, size.half_width - y) - size.radius


def _tilt(states: np.ndarray) -> np.ndarray:
    """Returns the tilt in degrees, for states (..., n)."""
    i, j = states[..., 5], states[..., 6]
    return np.degrees(np.arccos(1 - 2 * (i * i + j * j)))


def random_motors(robots: int, steps: int, *, full_speed: bool, seed: int = 0) -> np.ndarray:
    """Draws motor values, each held for 1 to 20 control steps, shape (robots, steps, 2).

    Args:
      robots: Number of robots.
      steps: Number of control steps.
      full_speed: Whether all motor values are -0.5 or 0.5; if not, they lie in [-0.5, 0.5].
      seed: Seed of the random motor values.
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


def markdown(found: Sequence[tuple[int, Mapping[str, np.ndarray]]]) -> str:
    """Returns the page: a row for each timestep.

    Args:
      found: For each timestep, its number of substeps and its measurements; the reference is first.
    """
    size = Dimensions.of(arena_spec().compile())
    reference = found[0][1]["calm"]
    rows = [
        {
            "timestep, ms": f"{1e3 * CONTROL_TIMESTEP / substeps:.3g}",
            "substeps": f"{substeps}",
            **_accuracy(arrays["calm"] - reference),
            **_speeds(arrays["fast"], arrays["spin"], size),
            **_drifts(arrays["spin"], arrays["rest"]),
            **_contacts(arrays),
            "us a step": f"{arrays['microseconds']:.1f}",
            "us a control step": f"{arrays['microseconds'] * substeps:.0f}",
        }
        for substeps, arrays in found
    ]
    cells = [[*rows[0]], *([*row.values()] for row in rows)]
    return "\n".join([*table(cells, "r" * len(rows[0])), ""])


def _accuracy(error: np.ndarray) -> dict[str, str]:
    """Describes the errors of poses relative to the reference, shape (B, 3)."""
    turn = np.abs((error[:, 2] + np.pi) % (2 * np.pi) - np.pi)
    return {
        "position error after 5 s, mm": f"{1e3 * np.hypot(error[:, 0], error[:, 1]).mean():.2f}",
        "heading error after 5 s, deg": f"{np.degrees(turn).mean():.2f}",
    }


def _speeds(fast: np.ndarray, spin: np.ndarray, size: Dimensions) -> dict[str, str]:
    """Describes the errors of speed, driving straight and spinning, from poses of shape (T, 3)."""
    speed = (fast[-1, 0] - fast[9, 0]) / 1.0
    rate = np.diff(np.unwrap(spin[:, 2]))[20:].mean() / CONTROL_TIMESTEP
    wanted = 2 * size.motor_speed / size.wheel_base
    return {
        "error of straight speed": f"{speed / size.motor_speed - 1:+.2%}",
        "error of spinning speed": f"{rate / wanted - 1:+.2%}",
    }


def _drifts(spin: np.ndarray, rest: np.ndarray) -> dict[str, str]:
    """Describes how far a spinning and a resting robot drift, from poses of shape (T, 3)."""
    return {
        "drift spinning, mm": f"{1e3 * np.hypot(*(spin[:, :2] - spin[0, :2]).T).max():.4f}",
        "drift at rest, mm": f"{1e3 * np.hypot(*rest[:, :2].T).max():.4f}",
    }


def _contacts(arrays: Mapping[str, np.ndarray]) -> dict[str, str]:
    """Describes the contacts with walls."""
    return {
        "deepest into a wall, mm": f"{max(0.0, -1e3 * float(arrays['deepest'])):.2f}",
        "tilt, deg": f"{arrays['tilt']:.1f}",
        "contact is not geometry": f"{arrays['differing']:.2%}",
        "in contact": f"{arrays['touching']:.1%}",
    }
