"""Runs jobs on this machine's cores, one process each."""

from __future__ import annotations

import dataclasses
import multiprocessing
import signal
import time
from collections.abc import Generator, Iterable, Sequence
from concurrent.futures import FIRST_COMPLETED, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from multiprocessing.process import BaseProcess
from typing import Any

from ..errors import Interrupted, RunError
from ..progress import JobProgress
from .jobs import Job, run_job
from .stop_requests import StopRequest, handling, stop_on_signals
from .worker import (
    children_without_script,
    follow_parent,
    prepare_process,
    single_threaded_children,
    stopped_by,
)

_GRACE = 30.0  # seconds for the checkpoints of processes after one of them has died


@dataclasses.dataclass(frozen=True)
class Local:
    """Executor that runs jobs on this machine's cores.

    Attributes:
      processes: Number of jobs that run at a time.
    """

    processes: int

    def __call__(self, jobs: Sequence[Job], progress: JobProgress) -> Generator[Job]:
        """Runs jobs; see `jobs.Executor`."""
        context = multiprocessing.get_context("spawn")  # torch does not support fork
        # A plain byte: an Event has a lock, with which a process may be killed.
        stop, reports = context.RawValue("b", 0), context.Queue()
        others = {*multiprocessing.active_children()}
        count = min(self.processes, len(jobs))
        with (
            single_threaded_children(),
            stop_on_signals() as request,
            ProcessPoolExecutor(count, context, _prepare, (stop, reports)) as pool,
        ):
            # Workers inherit this until `_prepare`: Ctrl-C reaches them, too, while they import. In
            # these milliseconds it is lost. A mask would be removed by Python's resource tracker.
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
            except Exception as error:
                if isinstance(error, BrokenProcessPool):
                    stop.value = 1
                    _end({*multiprocessing.active_children()} - others)
                if isinstance(error, BrokenProcessPool) and request.stop:
                    raise Interrupted from error  # the signal met a process that had just begun
                if isinstance(error, BrokenProcessPool | OSError):
                    raise stopped_by(error) from error
                raise
            except SystemExit as error:  # of a worker, whose work is not done
                raise RunError(f"a process ended itself (status {error.code})") from error
            finally:
                stop.value = 1  # the other processes must end too, before the pool is waited for
            if not complete:
                raise Interrupted
        progress.show(reports)  # a process that has ended has sent its last message


def _end(processes: Iterable[BaseProcess]) -> None:
    """Waits for processes that save a checkpoint, and kills those that cannot end.

    A process that was killed may have held the lock of a queue, for which others wait for ever.
    """
    deadline = time.monotonic() + _GRACE
    for process in processes:
        process.join(max(0.0, deadline - time.monotonic()))
        process.kill()


_STOP: Any
_REPORTS: Any
_REQUEST = StopRequest()


def _prepare(stop: Any, reports: Any) -> None:
    global _STOP, _REPORTS
    _STOP, _REPORTS = stop, reports
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the parent decides when to stop
    signal.signal(signal.SIGTERM, lambda *_: setattr(_REQUEST, "stop", True))
    follow_parent()
    prepare_process()


def _run(number: int, job: Job) -> bool:
    def stop() -> bool:
        return _REQUEST.stop or bool(_STOP.value)

    return run_job(job, stop, lambda done, message: _REPORTS.put((number, done, message)))
