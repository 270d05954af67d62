"""Runs jobs as Ray tasks on an existing cluster (extra `cluster`), see docs/performance.md.

All nodes must share the folders of the jobs: the jobs of a lost node then continue on others.
"""

from __future__ import annotations

import contextlib
import re
import socket
from collections.abc import Generator, Iterable, Sequence

import ray
from ray.exceptions import RayError, RayTaskError
from ray.util.queue import Queue
from ray.util.scheduling_strategies import NodeAffinitySchedulingStrategy

from ..errors import InputError, Interrupted, RunError
from ..progress import JobProgress
from ..storage import draft_name, remove_files, write_text
from .jobs import Job, run_job, stopped_by
from .local import prepare_process, stop_on_signals

# Other addresses make Ray start a cluster of its own, which every machine of the network can reach.
_ADDRESS = re.compile(r"(?:ray://)?([\w.-]+|\[[\da-fA-F:.]+\]):(\d{1,5})")
_WORKERS = {"env_vars": {"MUJOCO_GL": "off", "OMP_NUM_THREADS": "1"}}


class RayCluster:
    """Executor that runs jobs on the cores of a Ray cluster."""

    def __init__(self, address: str) -> None:
        """Connects to the cluster at "host:port"; raises InputError if that fails."""
        if not (parts := _ADDRESS.fullmatch(address)):
            raise InputError(f"the address must be host:port, got {address!r}")
        try:
            # Tried first, because Ray would retry for minutes.
            socket.create_connection((parts[1].strip("[]"), int(parts[2])), timeout=10).close()
            ray.shutdown()  # ends the connection of an earlier run
            ray.init(address, log_to_driver=False, configure_logging=False, runtime_env=_WORKERS)
        except (OSError, RayError, RuntimeError, ValueError, OverflowError) as error:
            cause = " ".join(str(error).split())
            raise InputError(f"no Ray cluster at {address!r} can be used ({cause})") from error

    def __call__(self, jobs: Sequence[Job], progress: JobProgress) -> Generator[Job]:
        """Runs jobs; see `jobs.Executor`."""
        here = NodeAffinitySchedulingStrategy(ray.get_runtime_context().get_node_id(), soft=False)
        reports = Queue(actor_options={"num_cpus": 0, "scheduling_strategy": here})
        # A file in a job's folder stops the job: every node sees it.
        stop_file = draft_name("stop")
        # Retried, because a lost node leaves a checkpoint; not for ever: a job may crash each time.
        task = ray.remote(num_cpus=1, max_retries=10)(_run)
        waiting = {task.remote(*each, reports, stop_file): each[1] for each in enumerate(jobs)}
        complete = True
        try:
            with stop_on_signals() as request:
                while waiting:
                    done, _ = ray.wait([*waiting], timeout=0.5)
                    progress.show(reports)
                    if request.stop:
                        _stop(waiting.values(), stop_file)
                    for result in done:
                        job = waiting.pop(result)
                        if ray.get(result):
                            yield job
                        else:
                            complete = False
                progress.show(reports)
        except RayTaskError as error:
            if isinstance(error.cause, InputError | RunError):
                raise error.cause from error
            raise  # a fault in our code: the traceback says where
        except (OSError, RayError) as error:
            raise stopped_by(error) from error
        finally:
            _stop(waiting.values(), stop_file)
            reports.shutdown(force=True)
        for folder in {job.path.parent for job in jobs}:
            remove_files(folder, stop_file.__eq__)
        if not complete:
            raise Interrupted


def _stop(jobs: Iterable[Job], stop_file: str) -> None:
    for folder in {job.path.parent for job in jobs}:
        with contextlib.suppress(OSError, InputError):
            write_text(folder / stop_file, "")


def _run(number: int, job: Job, reports: Queue, stop_file: str) -> bool:
    def report(done: float, message: str) -> None:
        with contextlib.suppress(RayError):  # the main process is gone
            reports.put((number, done, message))

    prepare_process()
    return run_job(job, (job.path.parent / stop_file).exists, report)
