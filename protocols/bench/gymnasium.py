"""Speed of the Gymnasium batch, compared with bare physics and with single environments.

Needs the extra `gym`. If EnvPool is installed, its PointMass is timed for comparison.
"""

from __future__ import annotations

import dataclasses
import importlib
import time
from collections.abc import Callable
from statistics import median

import gymnasium
import numpy as np

from ...tasks.gymnasium_env import ArenaVectorEnv
from ..errors import RunError
from ..pages import markdown
from .lives import BareRollout


@dataclasses.dataclass(frozen=True)
class InterfaceCosts:
    """Durations in [s] of a control step of all robots, one for each round.

    All interfaces are timed in alternation, so that other load on the machine slows them equally.

    Attributes:
      robots: Number of robots.
      threads: Number of threads used by the batch; `mujoco.rollout` uses as many.
      substeps: Number of physics steps in a control step.
      batch: Durations of a control step with the batch that `make_vec` returns.
      bare: Durations of a control step with `mujoco.rollout` alone, called once per control step.
        It starts from the batch's states, gets the batch's motor commands and evaluates all
        sensors. Its arrays are allocated before the clock starts.
      single: Durations of a control step with Gymnasium's SyncVectorEnv, one environment per robot.
      pool: Durations of a control step with EnvPool's PointMass: one environment per robot, and one
        physics step in a control step. Empty if EnvPool is not installed.
    """

    robots: int
    threads: int
    substeps: int
    batch: tuple[float, ...]
    bare: tuple[float, ...]
    single: tuple[float, ...]
    pool: tuple[float, ...]

    @property
    def over_bare(self) -> float:
        """Median ratio of the batch's steps per second to those of bare physics."""
        return median(b / a for a, b in zip(self.batch, self.bare, strict=True))

    @property
    def over_single(self) -> float:
        """Median ratio of the batch's steps per second to those of single environments."""
        return median(b / a for a, b in zip(self.batch, self.single, strict=True))

    def section(self) -> str:
        """Returns the section with the steps per second of all interfaces."""
        rows = [
            ("bare `mujoco.rollout`", self.bare, self.substeps),
            ("`make_vec`, the batch", self.batch, self.substeps),
            ("`SyncVectorEnv` of single environments", self.single, self.substeps),
        ]
        if self.pool:
            rows.append(("EnvPool's PointMass", self.pool, 1))
        cells = []
        for name, seconds, substeps in rows:
            rate = self.robots / median(seconds)
            cells.append((name, f"{rate:,.0f}", f"{rate * substeps:,.0f}"))
        return markdown.section(
            "Gymnasium interfaces",
            f"{self.robots} robots, {self.threads} threads, {len(self.batch)} rounds. The batch "
            f"runs at {self.over_bare:.2f} of the rate of bare physics and at "
            f"{self.over_single:.1f} times the rate of single environments.",
            ("", "control steps a second", "physics steps a second"),
            cells,
        )


def measure(
    robots: int = 500, threads: int = 2, rounds: int = 5, steps: int = 10
) -> InterfaceCosts:
    """Times the interfaces in wall avoidance with unit actions.

    Args:
      robots: Number of robots.
      threads: Number of threads used by the batch, and again by `mujoco.rollout` alone; 0 uses the
        calling thread.
      rounds: Number of timed rounds, after an additional round to warm up.
      steps: Number of control steps in a round.

    Raises:
      RunError: `mujoco.rollout` alone and the batch ended in different states.
    """
    name = "musebot/WallAvoidanceUnit-v0"
    batch = gymnasium.make_vec(name, robots, threads=threads, max_episode_steps=-1)
    single = gymnasium.make_vec(name, robots, vectorization_mode="sync", max_episode_steps=-1)
    assert isinstance(batch, ArenaVectorEnv)
    inside = batch._batch
    bare = BareRollout(inside.model, robots, inside.substeps, threads)
    pool = _pool(robots, threads)
    for vector in (batch, single):
        vector.reset(seed=0)
    random = np.random.default_rng(0)
    seconds: dict[str, list[float]] = {"batch": [], "bare": [], "single": [], "pool": []}
    for turn in range(rounds + 1):
        actions = random.uniform(-1, 1, (steps, robots, 2)).astype(np.float32)
        start = inside.arrays()["state"]
        taken = {
            "bare": bare.drive(start, actions.astype(float) / 2) / steps,
            "batch": _step_seconds(batch.step, actions),
            "single": _step_seconds(single.step, actions),
        }
        if not np.array_equal(bare.state, inside.arrays()["state"]):
            raise RunError("bare physics did not end in the states of the batch")
        if pool:
            taken["pool"] = _step_seconds(pool, actions)
        if turn:
            for what, value in taken.items():
                seconds[what].append(value)
    columns = {what: tuple(values) for what, values in seconds.items()}
    return InterfaceCosts(robots, threads, inside.substeps, **columns)


def _step_seconds(step: Callable[[np.ndarray], object], actions: np.ndarray) -> float:
    began = time.perf_counter()
    for action in actions:
        step(action)
    return (time.perf_counter() - began) / len(actions)


def _pool(robots: int, threads: int) -> Callable[[np.ndarray], object] | None:
    try:
        envpool = importlib.import_module("envpool")
    except ImportError:
        return None
    pool = envpool.make_gymnasium("PointMassEasy-v1", num_envs=robots, num_threads=max(threads, 1))
    pool.reset()
    return lambda actions: pool.step(actions.astype(float))
