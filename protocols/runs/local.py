"""Runs jobs in processes of this machine, and stops them on signals."""

from __future__ import annotations

import contextlib
import dataclasses
import multiprocessing
import os
import signal
import sys
import threading
import time
from collections.abc import Callable, Generator, Iterable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from multiprocessing.process import BaseProcess
from typing import Any

import torch

from ...tasks.batch import silence_warnings, stop_timers
from ..errors import Interrupted
from ..progress import JobProgress
from .jobs import Job, run_job, stopped_by

END_SIGNALS = signal.SIGTERM, signal.SIGHUP  # SIGHUP: a terminal was closed
_GRACE = 30.0  # seconds in which processes save checkpoints after another has died


@dataclasses.dataclass(frozen=True)
class Local:
    """Executor that runs jobs on this machine's cores.

    Attributes:
      processes: Largest number of jobs that run at a time.
    """

    processes: int

    def __call__(self, jobs: Sequence[Job], progress: JobProgress) -> Generator[Job]:
        """Runs jobs; see `jobs.Executor`."""
        with single_threaded_children():  # also the process that a queue starts
            yield from self._results(jobs, progress)

    def _results(self, jobs: Sequence[Job], progress: JobProgress) -> Generator[Job]:
        context = multiprocessing.get_context("spawn")  # torch does not support fork
        # A plain byte: an Event has a lock, which a killed process may hold for ever.
        stop, reports = context.RawValue("b", 0), context.Queue()
        others = {*multiprocessing.active_children()}
        count = min(self.processes, len(jobs))
        with (
            stop_on_signals() as request,
            ProcessPoolExecutor(count, context, _prepare, (stop, reports)) as pool,
        ):
            # Workers inherit the ignored Ctrl-C until `_prepare`, because it reaches them, too. For
            # these milliseconds it is lost. Python's resource tracker would remove a signal mask.
            with children_without_script(), handling(signal.SIG_IGN, signal.SIGINT):
                waiting = {pool.submit(_run, *each): each[1] for each in enumerate(jobs)}
                workers = {*multiprocessing.active_children()} - others
            complete = True
            try:
                while waiting:
                    done, _ = wait(waiting, timeout=0.2, return_when=FIRST_COMPLETED)
                    progress.show(reports)
                    # The pool does not notice the death of a process that has just begun.
                    workers |= {*multiprocessing.active_children()} - others
                    if not done and any(worker.exitcode is not None for worker in workers):
                        raise BrokenProcessPool
                    if request.stop:
                        stop.value = 1
                    for future in [f for f in waiting if f in done]:  # in the jobs' order
                        job = waiting.pop(future)
                        if future.result():
                            yield job
                        else:
                            complete = False
                progress.show(reports)
            except BrokenProcessPool as error:
                stop.value = 1
                _end({*multiprocessing.active_children()} - others)
                if request.stop:  # the signal killed a process that had just begun
                    raise Interrupted from error
                raise stopped_by(error) from error
            except OSError as error:
                raise stopped_by(error) from error
            finally:
                stop.value = 1  # the other processes must end: leaving the pool waits for them
            if not complete:
                raise Interrupted
        progress.show(reports)  # a process that has ended has sent its last message


def _end(processes: Iterable[BaseProcess]) -> None:
    """Waits until processes have saved checkpoints and ended; kills them after `_GRACE`.

    A process that died may have held the lock of a queue: others then wait for it for ever.
    """
    deadline = time.monotonic() + _GRACE
    for process in processes:
        process.join(max(0.0, deadline - time.monotonic()))
        process.kill()


# ---- Signals ----


class StopRequest:
    """Handler of signals that sets the flag `stop`.

    The flag is no `Event`, whose lock the interrupted thread may hold.
    """

    stop = False

    def __call__(self, number: int, frame: object) -> None:
        self.stop = True


@contextlib.contextmanager
def stop_on_signals() -> Iterator[StopRequest]:
    """Yields a `StopRequest`; Ctrl-C, SIGTERM and SIGHUP set its flag."""
    request = StopRequest()
    with handling(request, signal.SIGINT, *END_SIGNALS):
        yield request


@contextlib.contextmanager
def handling(
    handler: Callable[[int, Any], None] | signal.Handlers, *numbers: signal.Signals
) -> Iterator[None]:
    """Lets a handler receive signals in this context; does nothing outside the main thread.

    A SIGHUP that is ignored, as with `nohup`, stays ignored.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before = [(number, signal.signal(number, handler)) for number in _heard(numbers)]
    try:
        yield
    finally:
        for number, old in before:
            signal.signal(number, old)


def _heard(numbers: Iterable[signal.Signals]) -> list[signal.Signals]:
    """Returns the signals, without an ignored SIGHUP, and without those that Python cannot restore.

    These have a handler that another program installed.
    """
    ignored = signal.getsignal(signal.SIGHUP) == signal.SIG_IGN
    heard = [number for number in numbers if number != signal.SIGHUP or not ignored]
    return [number for number in heard if signal.getsignal(number) is not None]


# ---- Processes ----


def prepare_process() -> None:
    """Gives this process one torch thread, no MuJoCo timers and no MuJoCo log."""
    torch.set_num_threads(1)
    stop_timers()
    silence_warnings()


@contextlib.contextmanager
def single_threaded_children() -> Iterator[None]:
    """Makes processes that start in this context have one thread and no OpenGL.

    Several threads only slow down computations with small tensors, and nothing is drawn. Python
    does not look for its own modules in the working directory, where a user's file may have the
    name of one.
    """
    threads = {"OMP_NUM_THREADS": "1", "MKL_NUM_THREADS": "1"}
    settings = {**threads, "MUJOCO_GL": "off", "PYTHONSAFEPATH": "1"}
    before = {name: os.environ[name] for name in settings if name in os.environ}
    os.environ.update(settings)
    try:
        yield
    finally:
        for name in settings:
            del os.environ[name]
        os.environ.update(before)


@contextlib.contextmanager
def children_without_script() -> Iterator[None]:
    """Keeps processes that start in this context from importing the main module.

    Python imports the main module in every process that it spawns. A script without the usual main
    guard would simulate again there. Jobs do not need the module.
    """
    main = sys.modules["__main__"]
    hidden = {name: vars(main)[name] for name in ("__spec__", "__file__") if name in vars(main)}
    main.__spec__ = None
    vars(main).pop("__file__", None)
    try:
        yield
    finally:
        vars(main).update(hidden)


_STOP: Any
_REPORTS: Any
_REQUEST = StopRequest()


def _prepare(stop: Any, reports: Any) -> None:
    global _STOP, _REPORTS
    _STOP, _REPORTS = stop, reports
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the parent decides when to stop
    for number in _heard(END_SIGNALS):
        signal.signal(number, _REQUEST)
    threading.Thread(target=_follow_parent, daemon=True).start()
    prepare_process()


def _follow_parent() -> None:
    """Ends this process as soon as its parent process ends."""
    if (parent := multiprocessing.parent_process()) is not None:
        parent.join()
        os._exit(1)


def _run(number: int, job: Job) -> bool:
    def stop() -> bool:
        return _REQUEST.stop or bool(_STOP.value)

    return run_job(job, stop, lambda done, message: _REPORTS.put((number, done, message)))
