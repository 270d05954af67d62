"""Settings of all tests, and what many of them need."""

import os
import signal
import subprocess
import time

import pytest

# Nothing here draws in this process, and without a display looking for OpenGL warns.
os.environ.setdefault("MUJOCO_GL", "off")


@pytest.fixture
def lived_here(monkeypatch):
    """Cohorts live in this process: the processes are tested elsewhere, and slow to start."""
    import torch

    from musebot.protocols.simulation import engine
    from musebot.protocols.simulation import local as processes

    class Here:
        def __init__(self, count):
            assert count == 1

        def __call__(self, jobs, display):
            for job in jobs:
                assert engine.live(job, lambda: False, lambda step, text: None)
                yield job

    monkeypatch.setattr(processes, "Processes", Here)
    threads = torch.get_num_threads()
    torch.set_num_threads(1)  # as a process of lives has
    yield
    torch.set_num_threads(threads)


@pytest.fixture
def stopped():
    """Starts a command, stops it once a file is there: its exit status and what it said."""

    def stopped(line, folder, pattern):
        process = subprocess.Popen(line, stderr=subprocess.PIPE, text=True)
        try:
            while process.poll() is None and not [*folder.glob(pattern)]:
                time.sleep(0.001)
            process.send_signal(signal.SIGTERM)
            _, said = process.communicate(timeout=60)
        finally:
            process.kill()
        return process.returncode, said

    return stopped
