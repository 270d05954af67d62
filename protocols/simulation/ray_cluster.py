"""Runs jobs as Ray tasks on an existing cluster (extra `cluster`).

The jobs' folders must be on storage that all nodes share: jobs read and write there, so that the
jobs of a lost node continue elsewhere (docs/scaling.md).
"""

from __future__ import annotations

import contextlib
import logging
import socket
from collections.abc import Generator, Iterable, Sequence
from pathlib import Path
from typing import Any

from ..errors import InputError, Interrupted
from ..terminal import JobProgress
from .jobs import Job
from .signals import stop_on_signals
from .worker import prepare_process, stopped_by

try:
    import ray
    from ray.exceptions import RayError, RayTaskError
    from ray.util.queue import Queue
    from ray.util.scheduling_strategies import NodeAffinitySchedulingStrategy
except ImportError as error:
    raise InputError("Ray is not installed; pip install 'musebot[cluster]' gets it") from error

_STOP = "stop"  # file next to a job's file: a node sees it without a connection to the driver


class RayCluster:
    """Executor that runs jobs on the cores of a Ray cluster."""

    def __init__(self, address: str) -> None:
        """Connects to an existing cluster.

        Args:
          address: Address as "host:port", or "auto" for the cluster that this machine is part of.

        Raises:
          InputError: there is no such cluster.
        """
        try:
            if ":" in address:  # Ray itself would retry for minutes
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

    def __call__(self, jobs: Sequence[Job], progress: JobProgress) -> Generator[Job]:
        """Runs jobs; see `jobs.Executor`."""
        here = NodeAffinitySchedulingStrategy(ray.get_runtime_context().get_node_id(), soft=False)
        reports = Queue(actor_options={"num_cpus": 0, "scheduling_strategy": here})
        for file in _stop_files(jobs):
            file.parent.mkdir(exist_ok=True)
            file.unlink(missing_ok=True)
        # Retried without limit: a lost node leaves a checkpoint.
        task = ray.remote(num_cpus=1, max_retries=-1)(_run)
        waiting = {task.remote(*each, reports): each[1] for each in enumerate(jobs)}
        complete = True
        try:
            with stop_on_signals() as request:
                while waiting:
                    done, _ = ray.wait([*waiting], timeout=0.5)
                    progress.show(reports)
                    if request.stop:
                        _stop(waiting.values())
                    for result in done:
                        job = waiting.pop(result)
                        if ray.get(result):
                            yield job
                        else:
                            complete = False
                progress.show(reports)
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
        if not complete:
            raise Interrupted


def _stop_files(jobs: Iterable[Job]) -> set[Path]:
    return {job.path.parent / _STOP for job in jobs}


def _stop(jobs: Iterable[Job]) -> None:
    for file in _stop_files(jobs):
        with contextlib.suppress(OSError):
            file.touch()


def _run(number: int, job: Job, reports: Any) -> bool:
    prepare_process()
    (stop_file,) = _stop_files([job])

    def report(done: float, message: str) -> None:
        with contextlib.suppress(RayError):  # the driver is gone
            reports.put((number, done, message))

    return job.run(stop_file.exists, report)
