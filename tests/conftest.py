"""Settings and fixtures of all tests."""

import os
import signal
import subprocess
import time

import pytest

# Nothing here draws in this process, and without a display looking for OpenGL warns.
os.environ.setdefault("MUJOCO_GL", "off")


class InProcess:
    """An executor that runs jobs in this process.

    Attributes:
      most: Number of jobs after which it is interrupted.
      jobs: Jobs that it has run.
    """

    def __init__(self, most=10**9):
        self.most = most
        self.jobs = []

    def __call__(self, jobs, progress):
        from musebot.protocols.errors import Interrupted

        for job in jobs:
            if len(self.jobs) == self.most:
                raise Interrupted
            assert job.run(lambda: False, lambda done, message: None)
            self.jobs.append(job)
            yield job


@pytest.fixture
def in_process():
    """The class `InProcess`, for tests that pass an executor."""
    return InProcess


@pytest.fixture
def commands_in_process(monkeypatch):
    """Lets commands run their jobs in this process, with one thread as a worker has.

    Worker processes are tested elsewhere, and slow to start.
    """
    import torch

    from musebot.protocols.simulation import local

    monkeypatch.setattr(local, "Local", lambda processes: InProcess())
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    yield
    torch.set_num_threads(threads)


@pytest.fixture
def stopped():
    """Starts a command, and stops it once a file is there; returns its status and stderr."""

    def stopped(line, folder, pattern):
        process = subprocess.Popen(line, stderr=subprocess.PIPE, text=True)
        try:
            while process.poll() is None and not [*folder.glob(pattern)]:
                time.sleep(0.001)
            process.send_signal(signal.SIGTERM)
            _, printed = process.communicate(timeout=60)
        finally:
            process.kill()
        return process.returncode, printed

    return stopped
