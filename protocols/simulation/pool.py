"""Independent jobs over this machine's cores: what each comes to, and how far they are."""

from __future__ import annotations

import multiprocessing
import signal
from collections.abc import Callable, Generator, Sequence
from concurrent.futures import ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from typing import Any, TypeVar

from ..errors import Interrupted, RunError
from ..terminal import bar
from .local import follow_parent, heeding_signals, lean_children, prepare_process

Result = TypeVar("Result")

_TICKS: Any  # a number that all processes share


def tick(amount: int) -> None:
    """Says from within a job that so much more is done."""
    with _TICKS.get_lock():
        _TICKS.value += amount


def results(
    work: Callable[..., Result],
    jobs: Sequence[tuple],
    processes: int,
    show: Callable[[int], None] = lambda ticks: None,
) -> Generator[Result]:
    """What jobs come to, in their order, several at a time.

    Args:
      work: does a job; a function of a module.
      jobs: its arguments, one tuple a job.
      processes: jobs at a time, one core each.
      show: told, several times a second, how much all jobs together have ticked.

    Raises:
      Interrupted: by Ctrl-C or SIGTERM; whatever was in work is given up.
      RunError: a process died.
      Exception: whatever a job raises.
    """
    context = multiprocessing.get_context("spawn")  # torch does not like to be forked
    ticks = context.Value("q", 0)
    pool = ProcessPoolExecutor(processes, context, _prepare, (ticks,))
    with lean_children(), heeding_signals() as asked:
        try:
            for future in [pool.submit(work, *job) for job in jobs]:
                while not future.done():
                    wait([future], timeout=0.2)
                    show(ticks.value)
                    if asked.to_stop:
                        raise Interrupted
                yield future.result()
        except BrokenProcessPool as error:
            if asked.to_stop:
                raise Interrupted from error
            raise RunError(
                "a process died, perhaps for want of memory; the same command goes on"
            ) from error
        finally:
            for process in multiprocessing.active_children():
                process.terminate()
            pool.shutdown(cancel_futures=True)


def work_off(
    what: str,
    work: Callable[..., None],
    jobs: Sequence[tuple],
    processes: int,
    total: int,
    done: int = 0,
) -> None:
    """Does jobs that keep what they come to themselves, with progress and the time left.

    Args:
      what: the jobs are, in a word.
      work: does one; see `results`.
      jobs: its arguments, one tuple a job.
      processes: jobs at a time, one core each.
      total: ticks of all jobs.
      done: ticks of earlier calls.

    Raises:
      Interrupted, RunError, Exception: see `results`.
    """
    if not jobs:
        return
    with bar() as progress:
        task = progress.add_task(f"{len(jobs)} {what}", total=total, completed=done)

        def show(ticks: int) -> None:
            progress.update(task, completed=done + ticks)

        for _ in results(work, jobs, processes, show):
            pass


def _prepare(ticks: Any) -> None:
    global _TICKS
    _TICKS = ticks
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # it is the parent's to answer
    follow_parent()
    prepare_process()
