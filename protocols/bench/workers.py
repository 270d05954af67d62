"""Measures in worker processes: parallel throughput, and the cost of MuJoCo's timers."""

from __future__ import annotations

import contextlib
import dataclasses
import multiprocessing
import signal
from collections.abc import Iterator, Sequence
from multiprocessing.connection import Connection
from statistics import median
from typing import Literal

import torch

from ..errors import RunError
from ..lives.worker import DIED, prepare_process
from .lives import Setting, TimedCohort

Work = Literal["live", "replay"]  # a block of a cohort, or the bare replay of the last block


class BlockWorker:
    """A process that simulates or replays a block on request."""

    def __init__(self, setting: Setting, *, timers: bool = False) -> None:
        """Starts the process, whose first answer means that it is ready.

        Args:
          setting: Cohort to measure, and length of a block.
          timers: Whether MuJoCo's stage timers are on; MuJoCo's own default is on.
        """
        context = multiprocessing.get_context("spawn")
        self._pipe, far = context.Pipe()
        self._process = context.Process(target=_serve, args=(far, setting, timers), daemon=True)
        self._process.start()
        far.close()  # otherwise this process would not notice that the other one died

    def request(self, work: Work) -> None:
        """Starts to simulate or replay a block."""
        with contextlib.suppress(OSError):  # `answer` reports that it died
            self._pipe.send(work)

    def answer(self) -> float:
        """Waits for the end of the block; returns its duration in [s].

        Raises:
          RunError: The process died.
        """
        try:
            return self._pipe.recv()
        except (EOFError, OSError) as error:
            raise RunError(DIED) from error

    def close(self) -> None:
        """Ends the process."""
        self._pipe.close()
        self._process.join()


def _serve(pipe: Connection, setting: Setting, timers: bool) -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the parent ends this process
    torch.set_num_threads(1) if timers else prepare_process()
    cohort = TimedCohort(setting)
    cohort.simulate()
    cohort.replay()
    with contextlib.suppress(EOFError, OSError):  # the parent has closed the pipe
        pipe.send(0.0)
        while True:
            pipe.send(cohort.simulate() if pipe.recv() == "live" else cohort.replay())


@contextlib.contextmanager
def block_workers(
    settings: Sequence[Setting], timers: Sequence[bool] = ()
) -> Iterator[list[BlockWorker]]:
    """Provides a ready process for each setting, until the context ends.

    Args:
      settings: Setting of each process.
      timers: Whether MuJoCo's stage timers are on, one value for each process; if empty, the timers
        are off in all processes.
    """
    switches = timers or [False] * len(settings)
    workers: list[BlockWorker] = []
    try:
        for setting, switch in zip(settings, switches, strict=True):
            workers.append(BlockWorker(setting, timers=switch))
        for worker in workers:
            worker.answer()
        yield workers
    finally:
        for worker in workers:
            worker.close()


def run_together(workers: Sequence[BlockWorker], work: Work) -> float:
    """Runs a block in all processes at the same time; returns the longest duration in [s]."""
    for worker in workers:
        worker.request(work)
    return max([worker.answer() for worker in workers])


@dataclasses.dataclass(frozen=True)
class Scaling:
    """Durations of a block in one, two and all processes that work at the same time.

    Attributes:
      setting: Setting of the cohort, the same in every process.
      processes: Number of processes that worked at the same time for the durations `all`.
      one: Duration of a block in [s] when only one process works, one value for each repetition;
        each is the mean of two processes that work one after the other.
      two: Time in [s] until both of two processes have finished a block, one value for each
        repetition.
      all: Time in [s] until all processes have finished a block, one value for each repetition.
    """

    setting: Setting
    processes: int
    one: tuple[float, ...]
    two: tuple[float, ...]
    all: tuple[float, ...]

    @property
    def ratio(self) -> float:
        """Median ratio of the throughput of two processes to that of one."""
        return median(2 * one / two for one, two in zip(self.one, self.two, strict=True))

    @property
    def robot_steps_per_second(self) -> float:
        """Median throughput of all processes together, in robot-steps per second."""
        return self.processes * self.setting.robot_steps / median(self.all)


def scaling(setting: Setting, processes: int, turns: int) -> dict[Work, Scaling]:
    """Times one, two and all processes, simulating and replaying in alternation.

    Args:
      setting: Setting of the cohort, the same in every process.
      processes: Number of processes in the largest of the three timings.
      turns: Number of times that one, two and all processes are timed.
    """
    seconds: dict[Work, list[tuple[float, float, float]]] = {"live": [], "replay": []}
    with block_workers([setting] * max(2, processes)) as workers:
        pair, everyone = workers[:2], workers[:processes]
        for _ in range(turns):
            for work, rows in seconds.items():
                # Each of the two runs alone once, because cores may differ.
                one = sum(run_together([worker], work) for worker in pair) / 2
                two = run_together(pair, work)
                rows.append((one, two, two if everyone == pair else run_together(everyone, work)))
    return {
        work: Scaling(setting, processes, *zip(*rows, strict=True))
        for work, rows in seconds.items()
    }


def timer_cost(setting: Setting, turns: int) -> tuple[float, float]:
    """Times a block's physics, by `mujoco.rollout` alone, with MuJoCo's timers on and off.

    Args:
      setting: Cohort to measure, and length of a block.
      turns: Number of timings with the timers on, and again with the timers off.

    Returns:
      Two median durations in [s]: first with the timers on, then with the timers off.
    """
    seconds = []
    with block_workers([setting] * 2, timers=[True, False]) as workers:
        for _ in range(turns):
            seconds.append([run_together([worker], "replay") for worker in workers])
    timed, plain = zip(*seconds, strict=True)
    return median(timed), median(plain)
