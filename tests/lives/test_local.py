"""Jobs in the processes of this machine: their order, how they stop, and what goes wrong."""

import importlib
import multiprocessing
import os
import signal
import threading
import time
from concurrent.futures import ProcessPoolExecutor

import pytest

from musebot.protocols.errors import Interrupted, RunError
from musebot.protocols.lives import local
from musebot.protocols.lives.jobs import execute
from musebot.protocols.lives.local import Local

# Jobs as a module of their own, which worker processes can import.
JOBS = '''
import dataclasses, os, signal, time
from pathlib import Path

@dataclasses.dataclass(frozen=True)
class Write:
    """A job that writes when it began, after some looks at whether to stop."""

    path: Path
    looks: int = 0
    cost: float = 1.0

    def done(self):
        return self.path.exists()

    def run(self, stop, report):
        began = time.monotonic_ns()
        for _ in range(self.looks):
            if stop():
                return False
            time.sleep(0.05)
        report(self.cost, f"{self.path.name} is done")
        self.path.write_text(str(began))
        return True


@dataclasses.dataclass(frozen=True)
class Die(Write):
    """A job whose process is killed."""

    def run(self, stop, report):
        os.kill(os.getpid(), signal.SIGKILL)


@dataclasses.dataclass(frozen=True)
class Talk(Write):
    """A job that reports again and again."""

    def run(self, stop, report):
        self.path.with_suffix(".begun").touch()
        while not stop():
            report(0.0, "")
            time.sleep(0.01)
        return False


@dataclasses.dataclass(frozen=True)
class DieLocked(Write):
    """A job whose process is killed while it has the lock of the reports."""

    def run(self, stop, report):
        from musebot.protocols.simulation import local

        while not [*self.path.parent.glob("*.begun")]:
            time.sleep(0.01)
        local._REPORTS._wlock.acquire()
        os.kill(os.getpid(), signal.SIGKILL)


@dataclasses.dataclass(frozen=True)
class Fail(Write):
    """A job whose file cannot be written."""

    def run(self, stop, report):
        raise OSError(28, "No space left on device")


@dataclasses.dataclass(frozen=True)
class Fault(Write):
    """A job with a fault in its code."""

    def run(self, stop, report):
        raise ZeroDivisionError("a fault")


@dataclasses.dataclass(frozen=True)
class Exit(Write):
    """A job that ends its process."""

    def run(self, stop, report):
        raise SystemExit(3)
'''


@pytest.fixture(scope="module")
def kinds(tmp_path_factory):
    """The module `JOBS`."""
    folder = tmp_path_factory.mktemp("jobs")
    (folder / "jobs_of_test_local.py").write_text(JOBS)
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(folder)
        yield importlib.import_module("jobs_of_test_local")


def execute_all(jobs, processes=1, finished=lambda job: None):
    execute("jobs", jobs, Local(processes), finished, quiet=True)


def test_one_process_starts_jobs_in_their_order_and_hands_on_each(kinds, tmp_path, capfd):
    jobs, finished = [kinds.Write(tmp_path / str(number)) for number in range(3)], []
    execute("jobs", jobs, Local(1), finished.append)
    assert sorted(finished, key=jobs.index) == jobs
    began = [int(job.path.read_text()) for job in jobs]
    assert began == sorted(began)
    assert "2 is done" in capfd.readouterr().err


def test_a_job_whose_file_appears_while_it_waits_is_not_run_again(kinds, tmp_path, capfd):
    jobs = [kinds.Write(tmp_path / "one"), kinds.Write(tmp_path / "one", looks=1)]
    execute("jobs", jobs, Local(1))
    assert capfd.readouterr().err.count("one is done") == 1


@pytest.mark.parametrize("how", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_stops_the_jobs_and_keeps_what_is_done(how, kinds, tmp_path):
    jobs = [
        kinds.Write(tmp_path / "quick"),
        kinds.Write(tmp_path / "slow", looks=10**6),
        kinds.Write(tmp_path / "z"),
    ]

    def stop(job):
        threading.Timer(0.3, os.kill, (os.getpid(), how)).start()

    with pytest.raises(Interrupted):
        execute_all(jobs, finished=stop)
    assert [job.done() for job in jobs] == [True, False, False]  # the last one never began


@pytest.mark.parametrize(
    ("kind", "sentence"),
    [
        ("Die", "a process died, perhaps for want of memory"),
        ("Fail", "a file could not be read or written ([Errno 28] No space left on device)"),
    ],
)
def test_a_job_that_cannot_go_on_is_one_sentence(kind, sentence, kinds, tmp_path):
    with pytest.raises(RunError) as caught:
        execute_all(
            [getattr(kinds, kind)(tmp_path / "file"), kinds.Write(tmp_path / "other", looks=10**6)],
            processes=2,
        )
    assert str(caught.value) == f"{sentence}; the same command continues from the last checkpoints"


@pytest.fixture
def rescued():
    """Kills the processes of a test that waits for ever, and asserts that it did not."""
    ended, waited = threading.Event(), []

    def rescue():
        if not ended.wait(60):
            waited.append(True)
            [process.kill() for process in multiprocessing.active_children()]

    threading.Thread(target=rescue, daemon=True).start()
    yield
    ended.set()
    assert not waited


def test_the_death_of_a_process_that_has_just_begun_is_noticed(
    kinds, tmp_path, monkeypatch, rescued
):
    spawn = ProcessPoolExecutor._spawn_process

    def late(pool):  # the pool watches the processes that it had before it started one more
        time.sleep(0.5)
        spawn(pool)

    monkeypatch.setattr(ProcessPoolExecutor, "_spawn_process", late)
    jobs = [kinds.Write(tmp_path / "other", looks=10**6), kinds.Die(tmp_path / "file")]
    with pytest.raises(RunError, match="a process died, perhaps for want of memory"):
        execute_all(jobs, processes=2)

    def killed(pool):  # before it has imported anything
        late(pool)
        if len(pool._processes) == 2:
            os.kill([*pool._processes][-1], signal.SIGKILL)

    monkeypatch.setattr(ProcessPoolExecutor, "_spawn_process", killed)
    with pytest.raises(RunError, match="a process died, perhaps for want of memory"):
        execute_all(jobs, processes=2)


def test_a_process_killed_with_a_lock_does_not_hold_up_the_others(
    kinds, tmp_path, monkeypatch, rescued
):
    monkeypatch.setattr(local, "_GRACE", 0.5)
    jobs = [kinds.DieLocked(tmp_path / "file"), kinds.Talk(tmp_path / "other")]
    with pytest.raises(RunError, match="a process died, perhaps for want of memory"):
        execute_all(jobs, processes=2)


def test_a_fault_in_the_code_of_a_job_is_raised_as_it_is(kinds, tmp_path):
    with pytest.raises(ZeroDivisionError, match="a fault"):
        execute_all([kinds.Fault(tmp_path / "file")])


def test_a_job_that_ends_its_process_is_one_sentence(kinds, tmp_path):
    with pytest.raises(RunError, match=r"^a process ended itself \(status 3\)$"):
        execute_all([kinds.Exit(tmp_path / "file")])


def test_the_other_jobs_stop_where_one_cannot_be_handed_on(kinds, tmp_path):
    jobs = [kinds.Write(tmp_path / "quick"), kinds.Write(tmp_path / "slow", looks=10**6)]

    def refuse(job):
        raise OSError(28, "No space left on device")

    began = time.monotonic()
    with pytest.raises(OSError, match="No space left"):
        execute_all(jobs, processes=2, finished=refuse)
    assert time.monotonic() - began < 60
    assert not jobs[1].done()
