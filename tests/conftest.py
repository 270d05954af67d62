"""Settings and fixtures of all tests."""

import multiprocessing
import os
import subprocess
import sys
from pathlib import Path

import hypothesis
import numpy as np
import pytest

# A busy machine may need longer than hypothesis expects of an example.
hypothesis.settings.register_profile("musebot", deadline=None, max_examples=50)
hypothesis.settings.load_profile("musebot")
# Nothing here draws in this process, and without a display looking for OpenGL warns.
os.environ.setdefault("MUJOCO_GL", "off")
# Threads only slow the tests' small tensors down, and each worker of pytest has a core.
os.environ.setdefault("OMP_NUM_THREADS", "1")


class RootFolder:
    """The repository's root, a package whose folder can have any name, "musebot-main" included."""

    def pytest_collect_directory(self, path, parent):
        if path == Path(__file__).parents[1]:  # pytest would import it by its folder's name
            return pytest.Dir.from_parent(parent, path=path)
        return None


def pytest_configure(config):
    config.pluginmanager.register(RootFolder())


@pytest.fixture(scope="session")
def without_egl():
    """Why nothing can be rendered here, or an empty text."""
    command = [sys.executable, "-m", "musebot.protocols.pages.offscreen"]
    done = subprocess.run(command, capture_output=True, text=True)
    return f"no EGL here: {done.stderr.strip()}" if done.returncode else ""


@pytest.fixture(scope="session")
def egl(without_egl):
    """Skips a test where nothing can be rendered."""
    if without_egl:
        pytest.skip(without_egl)


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
        from musebot.protocols.runs.jobs import run_job

        for job in jobs:
            if len(self.jobs) == self.most:
                raise Interrupted
            assert run_job(job, lambda: False, lambda done, message: None)
            self.jobs.append(job)
            yield job


@pytest.fixture(scope="session")
def in_process():
    """The class `InProcess`, for tests that pass an executor."""
    return InProcess


@pytest.fixture
def commands_in_process(monkeypatch):
    """Lets commands run their jobs in this process, with one thread as a worker has.

    Worker processes are tested elsewhere, and slow to start.
    """
    import torch

    from musebot.protocols.runs import local

    monkeypatch.setattr(local, "Local", lambda processes: InProcess())
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    yield
    torch.set_num_threads(threads)


@pytest.fixture
def processes_that_have_imported(monkeypatch):
    """Lets processes fork from one that has imported PyTorch, which takes seconds of each."""
    context = multiprocessing.get_context("forkserver")
    context.set_forkserver_preload(["musebot.protocols.cli.speed"])
    monkeypatch.setattr(multiprocessing, "get_context", lambda method=None: context)


def invented_lives(experiment, rows, seed=0):
    """Returns what was measured of invented robots of one condition: their times, all else random.

    The minutes have the robots' times in the tests at their beginning.
    """
    from musebot.protocols.runs.conditions import Condition
    from musebot.protocols.runs.run import Lives, network_shapes

    draw, condition = np.random.default_rng(seed), Condition(rows[0].task, rows[0].proposer)
    schedule = experiment.life_of(condition.life)
    steps = schedule.steps_of_minutes()
    minutes = draw.integers(0, steps + 1, (len(rows), len(steps)))
    tests = np.array([[round(row.t_pre_s * 10), round(row.t_post_s * 10)] for row in rows])
    for part, times in zip(("pre", "post"), tests.T, strict=True):
        own = schedule.minutes_of(part)
        starts = steps[own].cumsum() - steps[own]
        minutes[:, own] = np.clip(times[:, None] - starts, 0, steps[own])
    training = minutes.sum(axis=1) - tests.sum(axis=1)
    before, after = (
        {
            name: draw.uniform(-1, 1, (len(rows), *shape)).astype(np.float32)
            for name, shape in (network_shapes(experiment, condition) or {}).items()
        }
        for _ in range(2)
    )
    events = np.column_stack([tests[:, 0], training, tests[:, 1]]).astype(np.int32)
    valid = np.array([row.valid for row in rows])
    return Lives(events, minutes.astype(np.int16), valid, before, after)


@pytest.fixture(scope="session")
def invented():
    """The function `invented_lives`, for tests of what reads a run."""
    return invented_lives
