"""A run on a Ray cluster leaves the bytes of the local run, even when a node is lost."""

import importlib
import os
import secrets
import shutil
import signal
import socket
import subprocess
import sys
import time

import pytest

from musebot.protocols.errors import InputError
from musebot.protocols.lives.conditions import Condition
from musebot.protocols.lives.experiment import Experiment
from musebot.protocols.lives.local import Local
from musebot.protocols.lives.manifest import MANIFEST
from musebot.protocols.lives.plan import Plan
from musebot.protocols.lives.run_files import RESULTS_FILE, ROBOTS_FILE
from musebot.protocols.lives.runs import simulate
from musebot.protocols.storage import draft_name

ray = pytest.importorskip("ray", reason="Ray cannot be installed here: pip install ray")
services = pytest.importorskip("ray._private.services")
ray_cluster = importlib.import_module("musebot.protocols.lives.ray_cluster")
RayCluster = ray_cluster.RayCluster
RAY = shutil.which("ray", path=os.path.dirname(sys.executable))

PLAN = Plan.of(
    Experiment(cohort_size=2, time_scale=0.03),
    [Condition("wall_avoidance", "fixed"), Condition("wall_avoidance", "creative")],
    4,
)


def contents(directory):
    return {name: (directory / name).read_bytes() for name in (ROBOTS_FILE, RESULTS_FILE)}


def free_port():
    with socket.socket() as listener:
        listener.bind(("127.0.0.1", 0))
        return listener.getsockname()[1]


def join(nodes, *arguments):
    """Starts a node as a process group of its own; returns once its cluster knows it."""
    settings = ["--num-cpus", "1", "--object-store-memory", str(10**8), *arguments]
    process = subprocess.Popen(
        [RAY, "start", "--block", *settings],
        stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, start_new_session=True,
        env=os.environ | {
            "PYTHONUNBUFFERED": "1", "RAY_USAGE_STATS_ENABLED": "0",
            # On a busy machine.
            "RAY_raylet_start_wait_time_s": "300", "RAY_agent_register_timeout_ms": "300000",
        },
    )  # fmt: skip
    nodes.append(process)
    said = []
    for line in process.stdout:
        said.append(line)
        if "Ray runtime started" in line:
            return
    raise AssertionError(f"no node: {''.join(said)}")


@pytest.fixture
def cluster(monkeypatch):
    """A cluster of two nodes, which listens on all addresses but runs nothing without its token."""
    monkeypatch.setenv("RAY_AUTH_MODE", "token")
    monkeypatch.setenv("RAY_AUTH_TOKEN", secrets.token_hex(32))
    port = free_port()
    address = f"127.0.0.1:{port}"
    nodes = []
    try:
        join(nodes, "--head", "--port", str(port), "--include-dashboard", "false")
        join(nodes, "--address", address)
        yield address, nodes[1]
    finally:
        for process in reversed(nodes):
            if process.poll() is None:
                os.killpg(process.pid, signal.SIGKILL)
            process.communicate()


def begun(directory, address):
    """Starts a run on a cluster; returns it once both nodes simulate a cohort."""
    run = subprocess.Popen(
        [
            sys.executable, "-m", "musebot", "run", str(directory), "--robots", "4",
            "--cohort-size", "2", "--time-scale", "0.03", "--task", "wall_avoidance",
            "--proposer", "fixed", "creative", "--save-every", "0.5", "--engine", "ray",
            "--address", address,
        ],
        stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True,
    )  # fmt: skip
    for _ in range(3000):
        if len(list((directory / "checkpoints").glob("*[0-9].safetensors"))) >= 2:
            return run
        assert run.poll() is None, run.stdout.read()
        time.sleep(0.1)
    run.kill()
    raise AssertionError(f"no two cohorts began: {run.communicate()[0]}")


@pytest.fixture(scope="module")
def here(tmp_path_factory):
    directory = tmp_path_factory.mktemp("here") / "run"
    simulate(directory, PLAN, Local(2), quiet=True)
    return contents(directory)


@pytest.mark.slow
def test_a_run_that_loses_a_node_leaves_the_local_runs_bytes(cluster, tmp_path, here):
    address, second = cluster
    run = begun(tmp_path / "there", address)
    os.killpg(second.pid, signal.SIGKILL)
    output = run.communicate(timeout=300)[0]
    assert run.returncode == 0, output
    assert contents(tmp_path / "there") == here


@pytest.mark.slow
def test_a_stopped_run_continues_elsewhere(cluster, tmp_path, here):
    address, _ = cluster
    run = begun(tmp_path / "there", address)
    signalled = time.time()
    run.send_signal(signal.SIGINT)
    output = run.communicate(timeout=300)[0]
    assert run.returncode == 130, output
    assert "the same command continues from here" in output
    assert {path.name for path in (tmp_path / "there").iterdir()} == {MANIFEST, "checkpoints"}
    checkpoints = [*(tmp_path / "there" / "checkpoints").iterdir()]
    assert len(checkpoints) >= 2 and {path.suffix for path in checkpoints} == {".safetensors"}
    stopped = [path for path in checkpoints if ".finished" not in path.suffixes]
    assert all(path.stat().st_mtime > signalled - 1 for path in stopped)
    simulate(tmp_path / "there", PLAN, Local(2), quiet=True)
    assert contents(tmp_path / "there") == here


@pytest.mark.slow
def test_a_study_on_a_cluster_leaves_the_local_ones_bytes(cluster, tmp_path):
    address, _ = cluster
    command = [
        sys.executable, "-m", "musebot", "study", "ablation", "--robots", "2", "--task",
        "wall_avoidance", "--body", "kinematic", "--time-scale", "0.001",
    ]  # fmt: skip
    workers = {"there": ["--engine", "ray", "--address", address], "here": ["--processes", "2"]}
    for name, options in workers.items():
        study = [*command, *options]
        study.insert(study.index("ablation") + 1, str(tmp_path / name))
        subprocess.run(study, check=True, capture_output=True, timeout=300)
    here, there = tmp_path / "here", tmp_path / "there"
    runs, there_too = (sorted(p.name for p in out.iterdir() if p.is_dir()) for out in (here, there))
    assert len(runs) == 12 and runs == there_too
    assert (here / "ablation.md").read_bytes() == (there / "ablation.md").read_bytes()
    for name in runs:
        assert contents(here / name) == contents(there / name)


@pytest.mark.slow
@pytest.mark.parametrize("token", [None, "f" * 64])
def test_a_cluster_runs_nothing_without_its_token(token, cluster, tmp_path, monkeypatch):
    address, _ = cluster
    monkeypatch.delenv("RAY_AUTH_TOKEN")
    monkeypatch.setenv("HOME", str(tmp_path))  # where Ray looks for a token
    if token:
        monkeypatch.setenv("RAY_AUTH_TOKEN", token)
    else:
        monkeypatch.delenv("RAY_AUTH_MODE")
    run = subprocess.run(
        [sys.executable, "-m", "musebot", "run", str(tmp_path / "run"), "--engine", "ray",
         "--address", address],
        capture_output=True, text=True, check=False, timeout=300,
    )  # fmt: skip
    assert run.returncode == 2, run.stderr
    assert f"musebot: the Ray cluster at '{address}' does not accept this process" in run.stderr
    assert "RAY_AUTH_TOKEN" in run.stderr and "Traceback" not in run.stderr
    assert not (tmp_path / "run").exists()


@pytest.mark.parametrize(
    "address", ["local", "", "auto ", "localhost", "ray://", "a b:1", "h:123456"]
)
def test_an_address_at_which_ray_would_start_an_open_cluster_is_refused(address, monkeypatch):
    monkeypatch.setattr(ray, "init", lambda **_: pytest.fail("Ray was started"))
    with pytest.raises(InputError) as caught:
        RayCluster(address)
    assert str(caught.value) == f"the address must be auto or host:port, got {address!r}"


class Asked:
    """A job that asks once whether it shall stop."""

    def __init__(self, path):
        self.path, self.told = path, None

    def done(self):
        return False

    def run(self, stop, report):
        self.told = stop()
        return not self.told


def test_a_users_file_named_stop_stops_no_job_and_stays(tmp_path):
    (tmp_path / "stop").write_text("mine")
    job, name = Asked(tmp_path / "job"), draft_name("stop")
    assert ray_cluster._run(0, job, None, name) and job.told is False
    ray_cluster._stop([job], name)
    job.told = None
    assert not ray_cluster._run(0, job, None, name) and job.told is None  # it did not begin
    assert {path.name for path in tmp_path.iterdir()} == {"stop", name}
    assert (tmp_path / "stop").read_text() == "mine"


def test_auto_without_a_cluster_says_that_there_is_none(monkeypatch, tmp_path):
    monkeypatch.delenv("RAY_ADDRESS", raising=False)
    monkeypatch.setattr(services, "find_gcs_addresses", list)
    monkeypatch.setenv("RAY_TMPDIR", str(tmp_path))
    with pytest.raises(InputError, match="there is no Ray cluster at 'auto' .Could not find any"):
        RayCluster("auto")


@pytest.mark.parametrize("where", ["file", "variable"])
def test_auto_does_not_wait_for_a_cluster_that_has_ended(where, monkeypatch, tmp_path):
    monkeypatch.setattr(ray, "init", lambda **_: pytest.fail("Ray would retry for minutes"))
    monkeypatch.setattr(services, "find_gcs_addresses", list)
    monkeypatch.delenv("RAY_ADDRESS", raising=False)
    address = f"127.0.0.1:{free_port()}"
    if where == "variable":
        monkeypatch.setenv("RAY_ADDRESS", address)
    else:  # in which Ray keeps the last cluster's
        monkeypatch.setenv("RAY_TMPDIR", str(tmp_path))
        (tmp_path / "ray").mkdir()
        (tmp_path / "ray" / "ray_current_cluster").write_text(address)
    with pytest.raises(InputError, match="there is no Ray cluster at 'auto' .*refused"):
        RayCluster("auto")


def test_an_environment_that_makes_auto_an_open_cluster_is_refused(monkeypatch):
    monkeypatch.setattr(ray, "init", lambda **_: pytest.fail("Ray was started"))
    monkeypatch.setenv("RAY_ADDRESS", "local")
    with pytest.raises(InputError, match="RAY_ADDRESS must be auto or host:port, got 'local'"):
        RayCluster("auto")


@pytest.mark.parametrize("command", ["musebot run", "musebot study ablation"])
def test_no_cluster_is_one_sentence_and_exit_status_2(command, tmp_path):
    address = f"127.0.0.1:{free_port()}"
    run = subprocess.run(
        [sys.executable, "-m", *command.split(), str(tmp_path / "run"), "--engine", "ray",
         "--address", address],
        capture_output=True, text=True, check=False, timeout=120,
    )  # fmt: skip
    assert run.returncode == 2, run.stderr
    assert f"there is no Ray cluster at '{address}' ([Errno 111] Connection refused)" in run.stderr
    assert list(tmp_path.iterdir()) == []
