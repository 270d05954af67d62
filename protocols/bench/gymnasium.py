"""What Gymnasium's doors cost: the batch beside bare physics, and beside single environments.

    python -m musebot.protocols.bench_doors --robots 500 --threads 2

Needs the extra `gym`. Where EnvPool is installed, its PointMass stands beside, for scale.
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
from ..errors import RunError, run_module
from .lives import Bare


@dataclasses.dataclass(frozen=True)
class Doors:
    """Measured in turns, so that what else the machine does slows all alike.

    Attributes:
      robots: in the batch.
      threads: of the batch and of bare physics.
      substeps: physics steps in a control step.
      batch: seconds of a control step of all robots, for each round.
      bare: of the physics alone, from the same states with the same motors: one
        `mujoco.rollout` a control step, sensors included, arrays laid out before.
      single: of Gymnasium's SyncVectorEnv of single environments.
      pool: of as many of EnvPool's PointMass on as many threads, a physics step each; empty
        where EnvPool is not installed.
    """

    robots: int
    threads: int
    substeps: int
    batch: tuple[float, ...]
    bare: tuple[float, ...]
    single: tuple[float, ...]
    pool: tuple[float, ...]

    @property
    def of_bare(self) -> float:
        """The batch's rate in terms of bare physics': the rounds' median."""
        return median(b / a for a, b in zip(self.batch, self.bare, strict=True))

    @property
    def of_single(self) -> float:
        """The batch's rate in terms of single environments': the rounds' median."""
        return median(b / a for a, b in zip(self.batch, self.single, strict=True))

    def table(self) -> str:
        """As Markdown."""
        rows = [
            ("bare `mujoco.rollout`", self.bare, self.substeps),
            ("`make_vec`, the batch", self.batch, self.substeps),
            ("`SyncVectorEnv` of single ones", self.single, self.substeps),
        ]
        if self.pool:
            rows.append(("EnvPool's PointMass", self.pool, 1))
        lines = ["| | control steps a second | physics steps a second |", "| --- | ---: | ---: |"]
        for name, seconds, substeps in rows:
            rate = self.robots / median(seconds)
            lines.append(f"| {name} | {rate:,.0f} | {rate * substeps:,.0f} |")
        lines.append("")
        lines.append(
            f"{self.robots} robots, {self.threads} threads, {len(self.batch)} rounds: the batch "
            f"runs at {self.of_bare:.2f} of bare physics and "
            f"at {self.of_single:.1f} times single ones."
        )
        return "\n".join(lines)


def measure(robots: int, threads: int, rounds: int, steps: int) -> Doors:
    """Measures wall avoidance with unit actions.

    Args:
      robots: in the batch.
      threads: of the batch and of bare physics.
      rounds: how often everything is measured in turn, after one to warm up.
      steps: control steps of all robots in a round.

    Raises:
      RunError: bare physics did not arrive where the batch did, to the bit.
    """
    name = "musebot/WallAvoidanceUnit-v0"
    batch = gymnasium.make_vec(name, robots, threads=threads, max_episode_steps=-1)
    single = gymnasium.make_vec(name, robots, vectorization_mode="sync", max_episode_steps=-1)
    assert isinstance(batch, ArenaVectorEnv)
    inside = batch._batch
    bare = Bare(inside.model, robots, inside.substeps, threads)
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
            "batch": _drive(batch.step, actions),
            "single": _drive(single.step, actions),
        }
        if not np.array_equal(bare.state, inside.arrays()["state"]):
            raise RunError("bare physics did not arrive where the batch did")
        if pool:
            taken["pool"] = _drive(pool, actions)
        if turn:
            for what, value in taken.items():
                seconds[what].append(value)
    columns = {what: tuple(values) for what, values in seconds.items()}
    return Doors(robots, threads, inside.substeps, **columns)


def _drive(step: Callable[[np.ndarray], object], actions: np.ndarray) -> float:
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


def main(robots: int = 500, threads: int = 2, rounds: int = 5, steps: int = 10) -> None:
    """Prints what Gymnasium's doors cost.

    Args:
      robots: in the batch.
      threads: of the batch and of bare physics; 0 for the calling thread.
      rounds: how often everything is measured in turn.
      steps: control steps of all robots in a round.
    """
    print(measure(robots, threads, rounds, steps).table())


if __name__ == "__main__":
    run_module(main)
