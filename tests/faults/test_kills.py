"""Processes killed at random moments, workers killed as for want of memory, and odd clocks."""

import collections
import contextlib
import json
import os
import queue
import random
import shutil
import signal
import subprocess
import sys
import threading
import time

import pytest

from musebot.protocols import terminal
from musebot.protocols.cli import parser as cli
from musebot.protocols.compare.study import STUDY_FILE
from musebot.protocols.lives import jobs
from musebot.protocols.lives.conditions import Condition
from musebot.protocols.lives.experiment import Experiment
from musebot.protocols.lives.manifest import MANIFEST
from musebot.protocols.lives.plan import Plan
from musebot.protocols.lives.runs import simulate
from musebot.protocols.progress import JobProgress

# Commands, forked from one process that has imported everything: kills then fall into the work,
# not into imports. The study has two runs only, and saves checkpoints more often.
FORKS = """
import json, os, sys
from multiprocessing import get_context
from musebot.protocols import cli
from musebot.protocols.simulation import local
from musebot.protocols.lives.runs import UnfinishedRun
from musebot.protocols.studies import jobs
from musebot.protocols.studies.ablation import Ablation

all_runs, all_jobs = Ablation.variants, UnfinishedRun.jobs
Ablation.variants = lambda self: all_runs(self)[:2]
UnfinishedRun.jobs = lambda self, save_every: all_jobs(self, min(save_every, 0.05))
jobs.SAVE_EVERY = 0.05
local.multiprocessing.get_context = lambda method: get_context("fork")
for line in sys.stdin:
    if (child := os.fork()) == 0:
        os.setsid()
        os.dup2(2, 1)
        os._exit(cli.main(json.loads(line)))
    print(child, flush=True)
    print(os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]), flush=True)
"""


class Commands:
    """Starts commands, one at a time, each in a session of its own."""

    def __init__(self, log):
        self._log = log
        self._process = subprocess.Popen(
            [sys.executable, "-c", FORKS],
            stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=log.open("a"), text=True,
        )  # fmt: skip
        self._numbers = queue.Queue()
        threading.Thread(target=self._read, daemon=True).start()

    def _read(self):
        for line in self._process.stdout:
            self._numbers.put(int(line))

    def start(self, arguments):
        """Starts a command; returns the number of its session."""
        self._process.stdin.write(json.dumps(arguments) + "\n")
        self._process.stdin.flush()
        return self._numbers.get()

    def ended(self, session, timeout=None):
        """Returns the exit status of a command, once all its processes have ended.

        Raises:
          queue.Empty: the command goes on.
        """
        status = self._numbers.get(timeout=timeout)
        for _ in range(1200):  # the last of its processes may still be dying
            try:
                os.killpg(session, 0)
            except ProcessLookupError:
                return status
            time.sleep(0.05)
        raise AssertionError(f"its processes are still there: {self.said()}")

    def run(self, arguments, kill_after=None):
        """Returns the exit status of a command, -9 if seconds after its start a kill hit it."""
        session = self.start(arguments)
        try:
            return self.ended(session, kill_after)
        except queue.Empty:
            with contextlib.suppress(ProcessLookupError):  # it has ended, or not yet begun
                os.killpg(session, signal.SIGKILL)
            return self.ended(session)

    def said(self):
        """Returns what the commands printed since the last call."""
        text = self._log.read_text()
        os.truncate(self._log, 0)
        return text

    def close(self):
        self._process.stdin.close()
        self._process.wait()


@pytest.fixture(scope="module")
def commands(tmp_path_factory):
    crew = Commands(tmp_path_factory.mktemp("commands") / "log")
    yield crew
    crew.close()


RUN = "--robots 4 --cohort-size 2 --time-scale 0.002 --processes 2 --save-every 0.05 --task "
STUDY = "--robots 4 --cohort-size 1 --time-scale 0.005 --processes 2 --body kinematic "
STUDY += "--task wall_avoidance"
EVOLVE = "--over noise epsilon --budget 8 --generation 4 --robots 3 --time-scale 0.02 --processes 2"


def words(kind, out):
    if kind == "evolve":
        return ["study", "evolve", str(out), *EVOLVE.split()]
    if kind == "study":
        return ["study", "ablation", str(out), *STUDY.split()]
    return ["run", str(out), *RUN.split(), "wall_avoidance", "--proposer", "creative", "fixed"]


def files(folder):
    """Returns the content of every file below a folder, and the names of empty folders.

    Manifests are compared without the list of versions: it has the state of the code as well.
    """
    found = {str(path.relative_to(folder)): path for path in folder.rglob("*")}
    contents = {name: p.read_bytes() if p.is_file() else None for name, p in found.items()}
    for name in [name for name in contents if name.endswith((MANIFEST, STUDY_FILE))]:
        contents[name] = json.loads(contents[name]) | {"made_with": None, "digest": None}
    return contents


def held(out):
    """Returns what a kill left: nothing, checkpoints, finished cohorts or more."""
    kept = {path.name for path in out.rglob("[!.]*")}
    if "evolve.md" in kept:
        return "the page"
    if any(path.parent.name == "evaluations" for path in out.rglob("*.safetensors")):
        return "evaluations"
    if any(name.endswith(".finished.safetensors") for name in kept):
        return "finished cohorts"
    if any(path.parent.name == "checkpoints" for path in out.rglob("*.safetensors")):
        return "checkpoints"
    return "results" if kept & {"brains.safetensors", "robots.csv"} else "nothing"


def survived(commands, kind, folder, kills, enough):
    """Kills a command at random moments until so many kills have hit it at work.

    Each time it is killed again and again until it ends; then its files are compared. If the kills
    left too little (`enough`), as on a busy machine, up to five times as many are tried.

    Returns:
      What the kills left, and how often.
    """
    began = time.monotonic()
    assert commands.run(words(kind, folder / "whole")) == 0, commands.said()
    seconds = time.monotonic() - began
    undisturbed, moments = files(folder / "whole"), random.Random(kind)
    left = collections.Counter()
    while left.total() < kills or (left.total() < 5 * kills and not enough(left)):
        out, latest = folder / "out", seconds
        began, before = time.monotonic(), left.total()
        while (status := commands.run(words(kind, out), moments.uniform(0, latest))) == -9:
            left[held(out)] += 1
            latest *= 1.25  # so that it ends however busy the machine is
        if left.total() == before:
            seconds = time.monotonic() - began
        assert status == 0, commands.said()
        assert files(out) == undisturbed, f"after {left}"
        shutil.rmtree(out)
    return left


@pytest.mark.slow
def test_a_run_killed_at_ten_random_moments_leaves_the_undisturbed_runs_bytes(commands, tmp_path):
    def enough(left):
        return left["checkpoints"] + left["finished cohorts"] >= 2

    left = survived(commands, "run", tmp_path, 10, enough)
    assert enough(left), left


@pytest.mark.slow
@pytest.mark.night
@pytest.mark.parametrize(
    ("kind", "kills", "wanted"),
    [
        ("run", 100, {"checkpoints", "finished cohorts"}),
        ("study", 100, {"checkpoints", "finished cohorts"}),
        ("evolve", 50, {"evaluations"}),
    ],
)
def test_many_kills_at_random_moments_leave_the_undisturbed_bytes(
    kind, kills, wanted, commands, tmp_path
):
    left = survived(commands, kind, tmp_path, kills, lambda left: wanted <= {*left})
    print(f"\n{kind}: {left.total()} kills, which left {dict(left)}")
    assert wanted <= {*left}, left


# Workers


def children(session):
    """Returns the processes that the leader of a session has started."""
    return [int(p) for p in open(f"/proc/{session}/task/{session}/children").read().split()]


def wait_for(session, there, seconds=300):
    """Waits until a command has made something; raises if it ends before or takes too long."""
    deadline = time.monotonic() + seconds
    while not there():
        os.kill(session, 0)  # ProcessLookupError: it has ended
        assert time.monotonic() < deadline, "it makes nothing"
        time.sleep(0.01)


@pytest.mark.skipif(sys.platform != "linux", reason="needs Linux's /proc")
def test_a_worker_killed_for_want_of_memory_is_one_sentence_and_the_run_continues(
    commands, tmp_path
):
    assert commands.run(words("run", tmp_path / "whole")) == 0
    commands.said()
    out = tmp_path / "out"
    session = commands.start(words("run", out))
    wait_for(session, lambda: [*out.glob("checkpoints/*.safetensors")] and children(session))
    os.kill(children(session)[0], signal.SIGKILL)
    assert commands.ended(session, 300) == 1
    said = commands.said()
    lines = [line for line in said.splitlines() if line.startswith("musebot")]
    assert lines[-1:] == [  # after the lines of the progress
        "musebot: a process died, perhaps for want of memory; the same command continues from the "
        "last checkpoints"
    ]
    assert "Traceback" not in said
    assert commands.run(words("run", out)) == 0
    assert files(out) == files(tmp_path / "whole")


# Two commands


def test_the_second_command_is_told_who_works_and_a_dead_one_blocks_nobody(
    commands, tmp_path, capsys
):
    out = tmp_path / "out"
    session = commands.start(words("run", out))
    wait_for(session, (out / "checkpoints").exists)
    os.kill(session, signal.SIGSTOP)  # so that it does not end before the second begins
    try:
        assert cli.main(words("run", out)) == 2
        said = capsys.readouterr().err
        assert f"musebot: another musebot (process {session}) is running in {out}\n" in said
    finally:
        os.killpg(session, signal.SIGKILL)
    assert commands.ended(session) == -signal.SIGKILL
    assert commands.run(words("run", out)) == 0, commands.said()


# Clocks


@pytest.mark.parametrize(
    "steps", [(0.0,), (1e6, -1e6), (-3600.0,)], ids=["stands", "jumps", "runs backwards"]
)
def test_a_clock_that_stands_or_steps_backwards_changes_nothing(
    steps, tmp_path, in_process, monkeypatch
):
    plan = Plan.of(
        Experiment(cohort_size=1, time_scale=0.0005, body="kinematic"),
        [Condition("wall_avoidance", "fixed")],
        2,
    )
    simulate(tmp_path / "whole", plan, in_process(), quiet=True)
    now = [time.time()]
    looks = iter(range(10**9))

    def clock():
        now[0] += steps[next(looks) % len(steps)]
        return now[0]

    monkeypatch.setattr(jobs, "_CHUNK", 4)
    monkeypatch.setattr(time, "time", clock)
    monkeypatch.setattr(time, "monotonic", clock)
    simulate(tmp_path / "out", plan, in_process(), save_every=1e-9, quiet=False)
    assert files(tmp_path / "out") == files(tmp_path / "whole")


def test_progress_is_shown_before_the_clock_has_moved(monkeypatch):
    monkeypatch.setattr(terminal.time, "monotonic", lambda: 5.0)
    reports = queue.Queue()
    with JobProgress("jobs", [10.0], quiet=True) as progress:
        for done in (1.0, 2.0):
            reports.put((0, done, ""))
            progress.show(reports)
        assert progress.line().startswith("20.0 %")
