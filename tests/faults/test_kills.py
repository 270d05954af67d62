"""Processes killed at random moments, workers killed as for want of memory, and odd clocks."""

import collections
import contextlib
import itertools
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
from pathlib import Path

import pytest
from helpers import files_below

from musebot.protocols.runs import jobs
from musebot.protocols.runs.conditions import Condition
from musebot.protocols.runs.experiment import Experiment
from musebot.protocols.runs.plan import Plan
from musebot.protocols.runs.simulation import simulate

# Commands, forked from one process that has imported everything: kills then fall into the work,
# not into imports. Checkpoints are saved more often than their users would.
FORKS = """
import contextlib, json, os, signal, sys
from multiprocessing import get_context
from musebot.protocols.cli import parser
from musebot.protocols.compare import jobs, tune
from musebot.protocols.runs import local, simulation
from musebot.protocols.pages import tables
with contextlib.suppress(ImportError):
    from musebot.protocols.runs import compiled_life

jobs.SAVE_EVERY = 0.05
local.multiprocessing.get_context = lambda method: get_context("fork")
for line in sys.stdin:
    if (child := os.fork()) == 0:
        os.setsid()
        signal.signal(signal.SIGHUP, signal.SIG_DFL)  # one that is ignored would stay ignored
        os.dup2(2, 1)
        os._exit(parser.main(json.loads(line)))
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
        """Returns the exit status of a command, once all its processes have ended; queue.Empty."""
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


TUNE = "--agent q_learner --robots 4 --trials 4 --kept 2 --time-scale 0.02 --processes 2"
RUN = "run OUT --life wall_avoidance --robots 4 --set cohort_size=2 --processes 2 "
RUN += "--save-every 0.05 --proposer"
LONGER = f"{RUN} creative --time-scale 0.004"  # there is time to stop it
LINES = {
    "run": f"{RUN} creative fixed --time-scale 0.004",
    "numba": "run OUT --life wall_avoidance --proposer creative fixed --robots 4 --body kinematic "
    "--set backend=numba cohort_size=2 --time-scale 0.02 --processes 2 --save-every 0.05",
    "tune": f"benchmark tune OUT {TUNE}",
}


def words(line, out):
    return line.replace("OUT", str(out)).split()


def files(folder):
    """Returns what `files_below` returns, with folders.

    JSON is compared without the list of versions: it has the state of the code as well.
    """
    contents = files_below(folder, folders=True)
    for path in [path for path in contents if path.suffix == ".json"]:
        contents[path] = json.loads(contents[path]) | {"made_with": None, "digest": None}
    return contents


def held(out):
    """Returns what a kill left: nothing, checkpoints, finished jobs or results."""
    kept = {str(path.relative_to(out)) for path in out.rglob("[!.]*")}
    if kept & {"results.safetensors.gz", "tune.md"}:
        return "results"
    if any(name.endswith(".finished.safetensors") or "trials/" in name for name in kept):
        return "finished jobs"
    return "checkpoints" if any("checkpoint" in n and "." in n for n in kept) else "nothing"


@pytest.fixture(scope="module")
def whole(commands, tmp_path_factory):
    """The files of an undisturbed run."""
    out = tmp_path_factory.mktemp("whole") / "out"
    assert commands.run(words(LONGER, out)) == 0, commands.said()
    return files(out)


def begun(commands, folder):
    """Starts a run, and waits for its first checkpoint; returns its session and its folder."""
    commands.said()
    session = commands.start(words(LONGER, out := folder / "out"))
    deadline = time.monotonic() + 300
    while not [*out.glob("checkpoints/*.safetensors")]:
        os.kill(session, 0)  # ProcessLookupError: it has ended
        assert time.monotonic() < deadline, "it makes nothing"
        time.sleep(0.01)
    return session, out


def survived(commands, kind, folder, kills, wanted):
    """Kills a command at random moments until so many kills have hit it at work.

    Each time it is killed again and again until it ends; then its files are compared. If the kills
    left too little, as on a busy machine, up to five times as many are tried.
    """
    began = time.monotonic()
    assert commands.run(words(LINES[kind], folder / "whole")) == 0, commands.said()
    seconds = time.monotonic() - began
    undisturbed, moments = files(folder / "whole"), random.Random(kind)
    left = collections.Counter()
    while left.total() < kills or (left.total() < 5 * kills and not wanted <= {*left}):
        out, latest = folder / "out", seconds
        began, before = time.monotonic(), left.total()
        while (status := commands.run(words(LINES[kind], out), moments.uniform(0, latest))) == -9:
            left[held(out)] += 1
            latest *= 1.25  # so that it ends however busy the machine is
        if left.total() == before:
            seconds = time.monotonic() - began
        assert status == 0, commands.said()
        assert files(out) == undisturbed, f"after {left}"
        shutil.rmtree(out)
    print(f"\n{kind}: {left.total()} kills, which left {dict(left)}")
    assert wanted <= {*left}, left


@pytest.mark.slow
def test_a_run_killed_at_five_random_moments_leaves_the_undisturbed_runs_bytes(commands, tmp_path):
    survived(commands, "run", tmp_path, 5, {"checkpoints"})


@pytest.mark.slow
@pytest.mark.night
@pytest.mark.parametrize("kind", LINES)
def test_many_kills_at_random_moments_leave_the_undisturbed_bytes(kind, commands, tmp_path):
    survived(commands, kind, tmp_path, 100, {"checkpoints", "finished jobs"})


# Signals to stop


@pytest.mark.parametrize("how", [signal.SIGINT, signal.SIGHUP])
def test_a_run_that_is_stopped_resumes_to_the_same_bytes(how, commands, whole, tmp_path):
    session, out = begun(commands, tmp_path)
    os.killpg(session, how)
    assert commands.ended(session, 300) == 130
    assert "stopped; the same command continues from here" in commands.said()
    assert not (out / "robots.csv").exists()
    assert commands.run(words(LONGER, out)) == 0
    assert files(out) == whole


# One process of several


@pytest.mark.skipif(sys.platform != "linux", reason="needs Linux's /proc")
def test_a_worker_killed_for_want_of_memory_is_one_sentence_and_the_run_continues(
    commands, whole, tmp_path
):
    session, out = begun(commands, tmp_path)
    workers = Path(f"/proc/{session}/task/{session}/children").read_text().split()
    os.kill(int(workers[0]), signal.SIGKILL)
    assert commands.ended(session, 300) == 1
    said = commands.said()
    assert "Traceback" not in said
    assert [line for line in said.splitlines() if line.startswith("musebot")][-1] == (
        "musebot: a process died, perhaps for want of memory; the same command continues from the "
        "last checkpoints"
    )
    assert commands.run(words(LONGER, out)) == 0
    assert files(out) == whole


def test_the_workers_of_a_killed_command_end_and_the_run_continues(commands, whole, tmp_path):
    session, out = begun(commands, tmp_path)
    os.kill(session, signal.SIGKILL)  # without its workers
    assert commands.ended(session, 300) == -signal.SIGKILL
    assert commands.run(words(LONGER, out)) == 0
    assert files(out) == whole


def test_a_deleted_working_directory_is_one_sentence(tmp_path):
    script = (
        "import os, sys; os.rmdir(os.getcwd()); from musebot.__main__ import main; sys.exit(main())"
    )
    gone = tmp_path / "gone"
    gone.mkdir()
    done = subprocess.run(
        [sys.executable, "-c", script, "run", "out"], cwd=gone, capture_output=True, text=True
    )
    assert done.returncode == 2
    assert done.stderr == "musebot: the working directory was deleted\n"


# Clocks


def test_a_clock_that_stands_or_steps_backwards_changes_nothing(tmp_path, in_process, monkeypatch):
    experiment = Experiment(cohort_size=1, time_scale=0.0005, body="kinematic")
    plan = Plan.of(experiment, [Condition("wall_avoidance", "fixed")], 2)
    simulate(tmp_path / "whole", plan, in_process(), quiet=True)
    monkeypatch.setattr(jobs, "_CHUNK", 4)
    for name, steps in {"stands": (0.0,), "jumps": (1e6, -1e6), "backwards": (-3600.0,)}.items():
        now, looks = [time.time()], itertools.cycle(steps)

        def clock(now=now, looks=looks):
            now[0] += next(looks)
            return now[0]

        with monkeypatch.context() as patch:
            patch.setattr(time, "time", clock)
            patch.setattr(time, "monotonic", clock)
            simulate(tmp_path / name, plan, in_process(), save_every=1e-9, quiet=False)
        assert files(tmp_path / name) == files(tmp_path / "whole")
