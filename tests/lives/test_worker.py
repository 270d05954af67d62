"""What a process that runs jobs needs: its environment, signals, and its parent."""

import os
import signal
import subprocess
import sys
import time

import pytest
import torch

from musebot.protocols.errors import RunError
from musebot.protocols.lives.stop_requests import stop_on_signals
from musebot.protocols.lives.worker import (
    prepare_process,
    single_threaded_children,
    stopped_by,
)


def test_a_prepared_process_has_one_torch_thread():
    threads = torch.get_num_threads()
    torch.set_num_threads(2)
    try:
        prepare_process()
        assert torch.get_num_threads() == 1
    finally:
        torch.set_num_threads(threads)


def test_processes_started_within_have_one_thread_and_no_opengl(monkeypatch):
    monkeypatch.setenv("OMP_NUM_THREADS", "7")
    monkeypatch.delenv("MKL_NUM_THREADS", raising=False)
    before = dict(os.environ)
    with pytest.raises(ZeroDivisionError), single_threaded_children():
        names = ("OMP_NUM_THREADS", "MKL_NUM_THREADS", "MUJOCO_GL")
        assert [os.environ[name] for name in names] == ["1", "1", "off"]
        raise ZeroDivisionError
    assert dict(os.environ) == before


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_becomes_a_request_and_the_old_handler_returns(number):
    before = signal.getsignal(number)
    with stop_on_signals() as request:
        assert not request.stop
        os.kill(os.getpid(), number)
        for _ in range(100):
            if request.stop:
                break
            time.sleep(0.01)
        assert request.stop
    assert signal.getsignal(number) == before


@pytest.mark.parametrize(
    ("error", "sentence"),
    [
        (OSError(28, "full"), "a file could not be read or written ([Errno 28] full)"),
        (ValueError(), "a process died, perhaps for want of memory"),
    ],
)
def test_what_stopped_a_simulation_is_one_sentence(error, sentence):
    stopped = stopped_by(error)
    assert isinstance(stopped, RunError)
    assert str(stopped) == f"{sentence}; the same command continues from the last checkpoints"


PARENT = """
import multiprocessing, sys, time
from musebot.protocols.simulation import worker

def child():
    worker.follow_parent()
    time.sleep(600)

if __name__ == "__main__":
    process = multiprocessing.get_context("fork").Process(target=child)
    process.start()
    print(process.pid, flush=True)
    time.sleep(600)
"""


@pytest.mark.skipif(not os.path.exists("/proc/self"), reason="needs Linux's /proc")
def test_a_process_ends_with_the_one_that_started_it():
    parent = subprocess.Popen([sys.executable, "-c", PARENT], stdout=subprocess.PIPE, text=True)
    try:
        child = int(parent.stdout.readline())
    finally:
        parent.kill()
        parent.wait()
    for _ in range(300):
        if not os.path.exists(f"/proc/{child}") or zombie(child):
            return
        time.sleep(0.1)
    os.kill(child, signal.SIGKILL)
    raise AssertionError("it is still there")


def zombie(process):
    try:
        with open(f"/proc/{process}/stat") as file:
            return file.read().rpartition(")")[2].split()[0] == "Z"
    except FileNotFoundError:
        return True
