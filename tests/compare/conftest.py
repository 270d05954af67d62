"""What the tests of studies share."""

import pytest
import torch
from helpers import files_below

from musebot.protocols.agents import agent_check
from musebot.protocols.lives.jobs import run_job


@pytest.fixture
def here():
    """An executor that runs jobs in this process: new processes are slow to start."""
    threads = torch.get_num_threads()
    torch.set_num_threads(1)  # as in a process of jobs

    def here(jobs, progress):
        for job in jobs:
            here.jobs.append(job)
            assert run_job(job, lambda: False, lambda cost, message: None)
            assert job.done()
            yield job

    here.jobs = []
    yield here
    torch.set_num_threads(threads)


@pytest.fixture
def listing():
    """The function `files_below`."""
    return files_below


@pytest.fixture
def cheap_costs(monkeypatch):
    """Measures what learners cost with fewer robots and steps."""
    monkeypatch.setattr(agent_check, "TIMED", (4, 30))
