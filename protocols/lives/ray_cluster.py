"""Runs jobs as Ray tasks on an existing cluster (extra `cluster`).

The jobs' folders must be on storage that all nodes share: jobs read and write there, so that the
jobs of a lost node continue elsewhere (docs/scaling.md).
"""

from __future__ import annotations

import contextlib
import logging
import os
import re
import socket
from collections.abc import Generator, Iterable, Sequence
from typing import Any, ClassVar

from ..errors import InputError, Interrupted, RunError
from ..progress import JobProgress
from ..storage import create_empty, draft_name, remove_files
from .jobs import Job, run_job
from .stop_requests import stop_on_signals
from .worker import prepare_process, stopped_by

try:
    import ray
    from ray.exceptions import RayError, RayTaskError
    from ray.util.queue import Queue
    from ray.util.scheduling_strategies import NodeAffinitySchedulingStrategy
except ImportError as error:
    raise InputError("Ray is not installed; pip install 'musebot[cluster]' gets it") from error

# Other values make Ray start a cluster of its own, that every machine of the network can reach.
_ADDRESS = re.compile(r"auto|(ray://)?([\w.-]+|\[[\da-fA-F:.]+\]):\d{1,5}")


def _host_and_port(address: str) -> tuple[str, int]:
    """Returns where an address is; for "auto" where Ray would look for this machine's cluster.

    Raises:
      ConnectionError: Ray knows no cluster of this machine.
    """
    if address == "auto":
        address = os.environ.get("RAY_ADDRESS") or "auto"
    if address == "auto":
        from ray._private import services  # there is no public function for this

        address = services.canonicalize_bootstrap_address(address) or ""
    host, _, port = address.removeprefix("ray://").rpartition(":")
    return host.strip("[]"), int(port)


class RayCluster:
    """Executor that runs jobs on the cores of a Ray cluster."""

    _address: ClassVar[str] = ""  # to which this process is connected

    def __init__(self, address: str) -> None:
        """Connects to an existing cluster.

        Args:
          address: Address as "host:port", or "auto" for the cluster that this machine is part of.

        Raises:
          InputError: the address has another form, or there is no such cluster.
        """
        if not _ADDRESS.fullmatch(address):
            raise InputError(f"the address must be auto or host:port, got {address!r}")
        variable = os.environ.get("RAY_ADDRESS") or "auto"
        if address == "auto" and not _ADDRESS.fullmatch(variable):
            raise InputError(f"RAY_ADDRESS must be auto or host:port, got {variable!r}")
        try:
            # Ray itself would retry for minutes.
            socket.create_connection(_host_and_port(address), timeout=10).close()
            if ray.is_initialized() and RayCluster._address == address:
                return  # an earlier run of this process has connected it
            ray.init(
                address=address,
                log_to_driver=False,
                logging_level=logging.ERROR,
                runtime_env={"env_vars": {"MUJOCO_GL": "off", "OMP_NUM_THREADS": "1"}},
            )
            RayCluster._address = address
        except (ConnectionError, RayError) as error:
            cause = " ".join(str(error).split())
            if isinstance(error, ConnectionRefusedError | ConnectionResetError) or cause.startswith(
                "Could not find any running Ray instance"
            ):
                raise InputError(f"there is no Ray cluster at {address!r} ({cause})") from error
            raise InputError(
                f"the Ray cluster at {address!r} does not accept this process ({cause}); a cluster "
                "with a token needs it in RAY_AUTH_TOKEN and RAY_AUTH_MODE=token here too"
            ) from error
        except (OSError, RuntimeError, ValueError, OverflowError) as error:
            cause = " ".join(str(error).split())
            raise InputError(f"there is no Ray cluster at {address!r} ({cause})") from error

    def __call__(self, jobs: Sequence[Job], progress: JobProgress) -> Generator[Job]:
        """Runs jobs; see `jobs.Executor`."""
        here = NodeAffinitySchedulingStrategy(ray.get_runtime_context().get_node_id(), soft=False)
        reports = Queue(actor_options={"num_cpus": 0, "scheduling_strategy": here})
        # A file beside a job's: a node need not reach the driver to see it.
        stop_name = draft_name("stop")
        folders = {job.path.parent for job in jobs}
        for folder in folders:
            folder.mkdir(exist_ok=True)
        # Retried without limit: a lost node leaves a checkpoint.
        task = ray.remote(num_cpus=1, max_retries=-1)(_run)
        waiting = {task.remote(*each, reports, stop_name): each[1] for each in enumerate(jobs)}
        complete = True
        try:
            with stop_on_signals() as request:
                while waiting:
                    done, _ = ray.wait([*waiting], timeout=0.5)
                    progress.show(reports)
                    if request.stop:
                        _stop(waiting.values(), stop_name)
                    for result in done:
                        job = waiting.pop(result)
                        if ray.get(result):
                            yield job
                        else:
                            complete = False
                progress.show(reports)
        except (OSError, RayError) as error:
            cause = getattr(error, "cause", error)
            if isinstance(cause, InputError | RunError):
                raise type(cause)(str(cause)) from error
            if isinstance(error, RayTaskError) and not isinstance(cause, OSError):
                raise  # a fault in our code: the traceback says where
            raise stopped_by(cause if isinstance(cause, OSError) else error) from error
        finally:
            _stop(waiting.values(), stop_name)
            reports.shutdown(force=True)
        for folder in folders:
            remove_files(folder, stop_name.__eq__)
        if not complete:
            raise Interrupted


def _stop(jobs: Iterable[Job], name: str) -> None:
    for folder in {job.path.parent for job in jobs}:
        with contextlib.suppress(OSError, InputError):
            create_empty(folder / name)


def _run(number: int, job: Job, reports: Any, stop_name: str) -> bool:
    prepare_process()
    stop_file = job.path.parent / stop_name

    def report(done: float, message: str) -> None:
        with contextlib.suppress(RayError):  # the driver is gone
            reports.put((number, done, message))

    try:
        return run_job(job, stop_file.exists, report)
    except SystemExit as error:  # Ray would begin the task again
        raise RunError(f"a process ended itself (status {error.code})") from error
