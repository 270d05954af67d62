"""Many machines: the same cohorts as Ray tasks on an existing cluster (extra `cluster`).

A run's directory must be on storage that all nodes share: checkpoints are read and written
there, so that a lost node's cohorts are taken up elsewhere. docs/scaling.md shows how.
"""

from __future__ import annotations

import contextlib
import logging
import socket
from collections.abc import Generator, Iterable, Sequence
from pathlib import Path
from typing import Any

from ..errors import InputError, Interrupted
from .engine import CHECKPOINTS, Display, Job, live
from .local import heeding_signals, prepare_process, stopped_by

try:
    import ray
    from ray.exceptions import RayError, RayTaskError
    from ray.util.queue import Queue
    from ray.util.scheduling_strategies import NodeAffinitySchedulingStrategy
except ImportError as error:
    raise InputError("Ray is not installed; pip install 'musebot[cluster]' gets it") from error

_STOP = "stop"  # a file in the checkpoints' folder; a node need not reach the driver to see it


class Ray:
    """A Ray cluster's cores, a cohort each at a time."""

    def __init__(self, address: str) -> None:
        """Connects to an existing cluster.

        Args:
          address: "host:port", or "auto" for the one this machine is part of.

        Raises:
          InputError: there is none.
        """
        try:
            if ":" in address:  # Ray itself would go on trying for minutes
                host, _, port = address.rpartition(":")
                socket.create_connection((host, int(port)), timeout=10).close()
            ray.init(
                address=address,
                log_to_driver=False,
                logging_level=logging.ERROR,
                runtime_env={"env_vars": {"MUJOCO_GL": "off", "OMP_NUM_THREADS": "1"}},
            )
        except (OSError, RuntimeError, ValueError, OverflowError) as error:
            raise InputError(f"there is no Ray cluster at {address!r}") from error

    def __call__(self, jobs: Sequence[Job], display: Display) -> Generator[Job]:
        """Lives cohorts; see `engine.Workforce`."""
        here = NodeAffinitySchedulingStrategy(ray.get_runtime_context().get_node_id(), soft=False)
        reports = Queue(actor_options={"num_cpus": 0, "scheduling_strategy": here})
        for file in _stop_files(jobs):
            file.parent.mkdir(exist_ok=True)
            file.unlink(missing_ok=True)
        # Retried for ever: what a lost node leaves is a checkpoint.
        task = ray.remote(num_cpus=1, max_retries=-1)(_live_there)
        waiting = {task.remote(*each, reports): each[1] for each in enumerate(jobs)}
        whole = True
        try:
            with heeding_signals() as asked:
                while waiting:
                    finished, _ = ray.wait([*waiting], timeout=0.5)
                    display.show(reports)
                    if asked.to_stop:
                        _stop(waiting.values())
                    for result in finished:
                        job = waiting.pop(result)
                        if ray.get(result):
                            yield job
                        else:
                            whole = False
                display.show(reports)
        except (OSError, RayError) as error:
            cause = getattr(error, "cause", error)
            if isinstance(error, RayTaskError) and not isinstance(cause, OSError):
                raise  # a fault in the code of an agent, or ours: the traceback says where
            raise stopped_by(cause if isinstance(cause, OSError) else error) from error
        finally:
            _stop(waiting.values())
            reports.shutdown(force=True)
        for file in _stop_files(jobs):
            file.unlink(missing_ok=True)
        if not whole:
            raise Interrupted


def _stop_files(jobs: Iterable[Job]) -> set[Path]:
    return {job.directory / CHECKPOINTS / _STOP for job in jobs}


def _stop(jobs: Iterable[Job]) -> None:
    for file in _stop_files(jobs):
        with contextlib.suppress(OSError):
            file.touch()


def _live_there(number: int, job: Job, reports: Any) -> bool:
    prepare_process()
    (stop_file,) = _stop_files([job])

    def report(step: int, message: str) -> None:
        with contextlib.suppress(RayError):  # nobody listens any more
            reports.put((number, step, message))

    return live(job, stop_file.exists, report)
