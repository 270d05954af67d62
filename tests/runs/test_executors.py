"""The contract of executors: jobs begin in their order and are handed on; signals and faults."""

import importlib
import multiprocessing
import os
import secrets
import shutil
import signal
import socket
import subprocess
import sys
import threading
import time

import pytest

from musebot.protocols.errors import InputError, Interrupted, RunError
from musebot.protocols.runs import local
from musebot.protocols.runs.jobs import execute
from musebot.protocols.runs.local import (
    Local,
    children_without_script,
    handling,
    single_threaded_children,
    stop_on_signals,
)

# Ray reads these when it is imported: the cluster below listens on all addresses, but runs nothing
# without its token.
os.environ |= {"RAY_AUTH_MODE": "token", "RAY_AUTH_TOKEN": secrets.token_hex(32)}
# Jobs as a module of their own, which processes can import.
JOBS = '''
import dataclasses, os, signal, time
from pathlib import Path

@dataclasses.dataclass(frozen=True)
class Write:
    """A job that writes when it began, after some looks at whether to stop, or that fails."""

    path: Path
    looks: int = 0
    fails: str = ""
    cost: float = 1.0

    def done(self):
        return self.path.exists()

    def run(self, stop, report):
        began = time.monotonic_ns()
        self.path.with_suffix(".begun").touch()
        if self.fails:
            self.fail()
        for _ in range(self.looks):
            if stop():
                self.path.with_suffix(".stopped").touch()
                return False
            report(0.0, "")
            time.sleep(0.02)
        report(self.cost, f"{self.path.name} is done")
        import torch
        threads = f"{os.environ['OMP_NUM_THREADS']}{torch.get_num_threads()}"
        self.path.write_text(f"{began} {threads} {os.environ['MUJOCO_GL']}")
        return True

    def fail(self):
        while len([*self.path.parent.glob("*.begun")]) < 2:
            time.sleep(0.01)
        if self.fails == "full disk":
            raise OSError(28, "No space left on device")
        if self.fails == "killed with a lock":
            from musebot.protocols.runs import local

            local._REPORTS._wlock.acquire()
            os.kill(os.getpid(), signal.SIGKILL)
        raise ZeroDivisionError("a fault")
'''
FOREVER = 10**6


@pytest.fixture(scope="module")
def kinds(tmp_path_factory):
    """The module `JOBS`."""
    folder = tmp_path_factory.mktemp("jobs")
    (folder / "jobs_of_test_executors.py").write_text(JOBS)
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(folder)
        patch.setenv("PYTHONPATH", str(folder), prepend=os.pathsep)
        yield importlib.import_module("jobs_of_test_executors")


@pytest.fixture(params=["local", pytest.param("ray", marks=pytest.mark.slow)])
def executor(request):
    """Makes an executor that runs so many jobs at a time."""
    if request.param == "local":
        request.getfixturevalue("processes_that_have_imported")
        return Local
    connected = request.getfixturevalue("connected")
    return lambda processes: connected


def execute_all(jobs, executor, finished=lambda job: None):
    execute("jobs", jobs, executor, finished, quiet=True)


def waits(condition, seconds=120):
    deadline = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < deadline
        time.sleep(0.02)


# The contract


def test_jobs_start_in_their_order_and_each_is_handed_on_and_run_once(
    executor, kinds, tmp_path, capfd
):
    jobs, finished = [kinds.Write(tmp_path / name) for name in "abca"], []
    execute("jobs", jobs, executor(1), finished.append)
    assert sorted(finished, key=lambda job: job.path) == sorted(jobs, key=lambda job: job.path)
    began, threads, gl = zip(*(job.path.read_text().split() for job in jobs[:3]), strict=True)
    if executor is Local:  # the cluster has two cores
        assert sorted(map(int, began)) == [*map(int, began)]
    assert {*threads} == {"11"} and {*gl} == {"off"}  # of OpenMP, and of torch
    said = capfd.readouterr().err
    first, *others = (said.count(f"{name} is done") for name in "abc")
    assert others == [1, 1]
    assert first == 1 or executor is not Local  # Ray may start both jobs of one file at once


def test_a_signal_stops_the_jobs_and_keeps_what_is_done(executor, kinds, tmp_path):
    how = signal.SIGTERM  # tests/faults/test_kills.py has the others
    made = executor(2)  # Ray sets a handler of its own
    before = signal.getsignal(how)
    looks = {"quick": 0, "slow": FOREVER, "slow too": FOREVER, "never": 0}
    jobs = [kinds.Write(tmp_path / name, number) for name, number in looks.items()]

    def stop(job):
        def kill():
            waits(lambda: len([*tmp_path.glob("slow*.begun")]) == 2)
            os.kill(os.getpid(), how)

        threading.Thread(target=kill).start()

    with pytest.raises(Interrupted):
        execute_all(jobs, made, stop)
    assert [job.done() for job in jobs[:3]] == [True, False, False]
    assert len([*tmp_path.glob("*.stopped")]) == 2
    if executor is Local:  # Ray may start the last job before the two slow ones
        assert not jobs[3].done() and not (tmp_path / "never.begun").exists()
    assert {path.suffix for path in tmp_path.iterdir()} == {"", ".begun", ".stopped"}
    assert signal.getsignal(how) == before


@pytest.mark.parametrize(
    ("how", "error", "words"),
    [
        ("full disk", RunError, "^a file could not be read or written .*No space left on device"),
        ("fault", ZeroDivisionError, "a fault"),
        ("not handed on", OSError, "No space left"),
    ],
)
def test_where_a_job_cannot_go_on_the_others_stop(how, error, words, executor, kinds, tmp_path):
    job = kinds.Write(tmp_path / "file", fails="" if how == "not handed on" else how)
    other = kinds.Write(tmp_path / "other", FOREVER)

    def refuse(job):
        waits((tmp_path / "other.begun").exists)
        raise OSError(28, "No space left on device")

    with pytest.raises(error, match=words):
        execute_all([job, other], executor(2), refuse)
    waits((tmp_path / "other.stopped").exists)


# Processes of this machine


def test_a_killed_process_is_one_sentence_and_holds_up_nobody(
    processes_that_have_imported, kinds, tmp_path, monkeypatch
):
    monkeypatch.setattr(local, "_GRACE", 0.5)
    dying = kinds.Write(tmp_path / "file", fails="killed with a lock")
    jobs = [dying, kinds.Write(tmp_path / "other", FOREVER)]
    ended = threading.Event()

    def rescue():
        if not ended.wait(120):
            [process.kill() for process in multiprocessing.active_children()]

    threading.Thread(target=rescue, daemon=True).start()
    with pytest.raises(RunError, match="^a process died, perhaps for want of memory; the same"):
        execute_all(jobs, Local(2))
    ended.set()
    assert not multiprocessing.active_children()


@pytest.mark.parametrize("request_stop", [False, True])
def test_the_death_of_a_process_that_has_just_begun_is_noticed(
    request_stop, kinds, tmp_path, monkeypatch
):
    spawn = local.ProcessPoolExecutor._spawn_process

    def killed(pool):  # before it has imported anything
        spawn(pool)
        if len(pool._processes) == 2:
            if request_stop:
                os.kill(os.getpid(), signal.SIGTERM)
            os.kill([*pool._processes][-1], signal.SIGKILL)

    monkeypatch.setattr(local.ProcessPoolExecutor, "_spawn_process", killed)
    monkeypatch.setattr(local, "_GRACE", 0.5)
    jobs = [kinds.Write(tmp_path / "a", FOREVER), kinds.Write(tmp_path / "b", FOREVER)]
    with pytest.raises(Interrupted if request_stop else RunError):
        execute_all(jobs, Local(2))


@pytest.mark.slow
def test_processes_take_pythons_own_modules_not_those_of_the_working_directory(
    kinds, tmp_path, monkeypatch
):
    (tmp_path / "socket.py").write_text("raise SystemExit")
    monkeypatch.chdir(tmp_path)
    execute("jobs", [kinds.Write(tmp_path / "job")], Local(1), lambda job: None, quiet=True)
    assert (tmp_path / "job").exists()


def test_a_hangup_that_is_ignored_as_with_nohup_stays_ignored():
    before = signal.signal(signal.SIGHUP, signal.SIG_IGN)
    try:
        with stop_on_signals() as request:
            os.kill(os.getpid(), signal.SIGHUP)
            time.sleep(0.05)
            assert not request.stop
            os.kill(os.getpid(), signal.SIGTERM)
            waits(lambda: request.stop)
        assert signal.getsignal(signal.SIGHUP) == signal.SIG_IGN
    finally:
        signal.signal(signal.SIGHUP, before)


def test_other_threads_handle_no_signals():
    def use():
        with handling(signal.SIG_IGN, signal.SIGTERM):
            handlers.append(signal.getsignal(signal.SIGTERM))

    handlers = []
    thread = threading.Thread(target=use)
    thread.start()
    thread.join()
    assert handlers == [signal.getsignal(signal.SIGTERM)]


def test_what_is_changed_for_processes_that_start_is_changed_back(monkeypatch):
    monkeypatch.setenv("OMP_NUM_THREADS", "7")
    monkeypatch.delenv("MKL_NUM_THREADS", raising=False)
    main = sys.modules["__main__"]
    before = dict(os.environ), dict(vars(main))
    with pytest.raises(ZeroDivisionError), single_threaded_children(), children_without_script():
        names = ("OMP_NUM_THREADS", "MKL_NUM_THREADS", "MUJOCO_GL")
        assert [os.environ[name] for name in names] == ["1", "1", "off"]
        assert main.__spec__ is None and "__file__" not in vars(main)
        raise ZeroDivisionError
    assert (dict(os.environ), dict(vars(main))) == before


# Ray


def free_port():
    with socket.socket() as listener:
        listener.bind(("127.0.0.1", 0))
        return listener.getsockname()[1]


def started_node(*arguments):
    """Starts a node of a cluster as a process group of its own."""
    ray = shutil.which("ray", path=os.path.dirname(sys.executable))
    node = subprocess.Popen(
        [ray, "start", "--block", "--object-store-memory", str(10**8), *arguments],
        stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, start_new_session=True,
        env=os.environ | {
            "PYTHONUNBUFFERED": "1", "RAY_USAGE_STATS_ENABLED": "0",
            # No processes that no job can use.
            "RAY_prestart_worker_first_driver": "false",
            # On a busy machine.
            "RAY_raylet_start_wait_time_s": "300", "RAY_agent_register_timeout_ms": "300000",
        },
    )  # fmt: skip
    assert any("Ray runtime started" in line for line in node.stdout)
    return node


def kill(node):
    os.killpg(node.pid, signal.SIGKILL)
    node.communicate()


@pytest.fixture(scope="module")
def cluster(kinds):
    """The address of a cluster of one node with two cores, which needs a token."""
    ray = pytest.importorskip("ray", reason="Ray cannot be installed here: pip install ray")
    port, dashboard = str(free_port()), ("--include-dashboard", "false")
    node = started_node("--head", "--port", port, "--num-cpus", "2", *dashboard)
    yield f"127.0.0.1:{port}"
    ray.shutdown()
    kill(node)


@pytest.fixture(scope="module")
def connected(cluster):
    """An executor, whose processes the tests share: to start one takes seconds."""
    ray_cluster = importlib.import_module("musebot.protocols.runs.ray_cluster")
    ray_cluster.RayCluster(cluster)
    return ray_cluster.RayCluster(cluster)  # as the second command of a process


@pytest.mark.slow
@pytest.mark.night
def test_the_jobs_of_a_lost_node_continue_elsewhere(cluster, kinds, tmp_path):
    from musebot.protocols.runs.ray_cluster import RayCluster

    lost = started_node("--address", cluster, "--num-cpus", "1")

    def lose():
        waits(lambda: len([*tmp_path.glob("*.begun")]) == 3)
        kill(lost)

    threading.Thread(target=lose).start()
    jobs = [kinds.Write(tmp_path / str(number), looks=300) for number in range(3)]
    execute_all(jobs, RayCluster(cluster))
    assert all(job.done() for job in jobs) and lost.poll() is not None


def test_an_address_at_which_ray_might_start_an_open_cluster_is_refused(monkeypatch):
    ray = pytest.importorskip("ray")
    ray_cluster = importlib.import_module("musebot.protocols.runs.ray_cluster")
    monkeypatch.setattr(ray, "init", lambda *of, **options: pytest.fail("Ray was started"))
    for address in ("local", "auto", "", "h:1 ", "localhost", "ray://", "a b:1", "h:123456"):
        with pytest.raises(InputError, match="^the address must be host:port, got "):
            ray_cluster.RayCluster(address)
    with pytest.raises(InputError, match="^no Ray cluster at .* can be used .*refused"):
        ray_cluster.RayCluster(f"127.0.0.1:{free_port()}")


@pytest.mark.slow
@pytest.mark.parametrize("token", ["f" * 64, pytest.param(None, marks=pytest.mark.night)])
def test_a_cluster_runs_nothing_without_its_token(token, cluster, tmp_path, monkeypatch):
    monkeypatch.delenv("RAY_AUTH_TOKEN")
    monkeypatch.setenv("HOME", str(tmp_path))  # where Ray looks for a token
    monkeypatch.setenv("RAY_NUM_REDIS_GET_RETRIES", "2")  # it would ask for 20 s
    if token:
        monkeypatch.setenv("RAY_AUTH_TOKEN", token)
    else:
        monkeypatch.delenv("RAY_AUTH_MODE")
    run = subprocess.run(
        [sys.executable, "-m", "musebot", "run", str(tmp_path / "run"), "--ray", cluster],
        capture_output=True, text=True, check=False, timeout=300,
    )  # fmt: skip
    assert run.returncode == 2, run.stderr
    assert f"musebot: no Ray cluster at '{cluster}' can be used" in run.stderr
    assert "oken" in run.stderr and "Traceback" not in run.stderr
    assert not (tmp_path / "run").exists()
