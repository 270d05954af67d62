"""This machine's cores: a process each lives a cohort at a time, and stops when it is asked to."""

from __future__ import annotations

import contextlib
import dataclasses
import multiprocessing
import os
import signal
import threading
from collections.abc import Generator, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from multiprocessing.synchronize import Event
from typing import Any

import torch

from ...tasks import silence_warnings, stop_timers
from ..errors import Interrupted, RunError
from .engine import Display, Job, live


@dataclasses.dataclass(frozen=True)
class Processes:
    """This machine's cores, a cohort each at a time.

    Attributes:
      count: how many cohorts live at a time.
    """

    count: int

    def __call__(self, jobs: Sequence[Job], display: Display) -> Generator[Job]:
        """Lives cohorts; see `engine.Workforce`."""
        context = multiprocessing.get_context("spawn")
        stop, reports = context.Event(), context.Queue()
        count = min(self.count, len(jobs))
        with (
            lean_children(),
            heeding_signals() as asked,
            ProcessPoolExecutor(count, context, _prepare_process, (stop, reports)) as pool,
        ):
            waiting = {pool.submit(_live_here, *each): each[1] for each in enumerate(jobs)}
            whole = True
            try:
                while waiting:
                    finished, _ = wait(waiting, timeout=0.2, return_when=FIRST_COMPLETED)
                    display.show(reports)
                    if asked.to_stop:
                        stop.set()
                    for future in finished:
                        job = waiting.pop(future)
                        if future.result():
                            yield job
                        else:
                            whole = False
                display.show(reports)
            except Exception as error:
                if isinstance(error, BrokenProcessPool) and asked.to_stop:
                    raise Interrupted from error  # the signal met a process that had just begun
                if isinstance(error, BrokenProcessPool | OSError):
                    raise stopped_by(error) from error
                raise
            finally:
                stop.set()  # the others must end too, before the pool is waited for
            if not whole:
                raise Interrupted


def stopped_by(error: Exception) -> RunError:
    """Says what stopped a run, in one sentence."""
    what = (
        f"a file could not be written ({error})"
        if isinstance(error, OSError)
        else "a process died, perhaps for want of memory"
    )
    return RunError(f"{what}; the same command goes on from the last checkpoints")


@contextlib.contextmanager
def lean_children() -> Iterator[None]:
    """Lets processes that are started within have one thread and no OpenGL, as they read then.

    On tensors this small several threads only get into each other's way, and nothing is drawn.
    """
    settings = {"OMP_NUM_THREADS": "1", "MKL_NUM_THREADS": "1", "MUJOCO_GL": "off"}
    before = {name: os.environ.get(name) for name in settings}
    os.environ.update(settings)
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                os.environ.pop(name, None)
            else:
                os.environ[name] = value


class Asked:
    """What signals have asked for.

    A handler only sets a plain flag: an Event is held by a lock that the interrupted thread
    may hold itself.

    Attributes:
      to_stop: by Ctrl-C or SIGTERM.
    """

    to_stop = False


@contextlib.contextmanager
def heeding_signals() -> Iterator[Asked]:
    """Turns Ctrl-C and SIGTERM into a polite request."""
    asked = Asked()

    def handler(number: int, frame: Any) -> None:
        del number, frame
        asked.to_stop = True

    before = {number: signal.signal(number, handler) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield asked
    finally:
        for number, old in before.items():
            signal.signal(number, old)


_STOP: Event
_REPORTS: Any
_ASKED = Asked()


def _prepare_process(stop: Event, reports: Any) -> None:
    global _STOP, _REPORTS
    _STOP, _REPORTS = stop, reports
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the parent tells us, in its own time
    signal.signal(signal.SIGTERM, lambda *_: setattr(_ASKED, "to_stop", True))
    follow_parent()
    prepare_process()


def follow_parent() -> None:
    """Lets this process die as soon as the one that started it does."""

    def follow() -> None:
        if (parent := multiprocessing.parent_process()) is not None:
            parent.join()
            os._exit(1)

    threading.Thread(target=follow, daemon=True).start()


def prepare_process() -> None:
    """Makes this process one that lives cohorts: one thread, no timers, no log of MuJoCo's."""
    torch.set_num_threads(1)
    stop_timers()
    silence_warnings()


def _live_here(number: int, job: Job) -> bool:
    def stop() -> bool:
        return _ASKED.to_stop or _STOP.is_set()

    return live(job, stop, lambda step, text: _REPORTS.put((number, step, text)))
