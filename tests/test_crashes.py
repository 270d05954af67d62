"""After a crash at any moment the same command leaves the bytes of the undisturbed run."""

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

from musebot.protocols.experiment.conditions import Condition
from musebot.protocols.experiment.experiment import Experiment
from musebot.protocols.experiment.manifest import MANIFEST
from musebot.protocols.experiment.plan import Plan
from musebot.protocols.results.run_files import BRAINS_FILE, CURVES_FILE, ROBOTS_FILE, planned
from musebot.protocols.simulation.runs import simulate

FILES = {ROBOTS_FILE, CURVES_FILE, BRAINS_FILE}


def contents(directory):
    """Returns the files of a finished run; checks that it left no others but its tables."""
    left = {path.name for path in directory.iterdir()}
    assert left - {"tables.md"} == {MANIFEST, *FILES}
    return {name: (directory / name).read_bytes() for name in FILES}


# Between any two operations on the disk


class Dead(BaseException):
    """The process was killed: nothing catches this, and nothing is cleaned up."""


class Disk:
    """Counts the operations on the disk, and fails at the n-th.

    A process that is killed there does nothing more, and leaves half a file if it was writing
    one. A process whose operation fails there handles the error.
    """

    OPERATIONS = ("fsync", "mkdir", "replace", "rmdir", "unlink")

    def __init__(self, fails_at, error):
        self.done = 0
        self._fails_at = fails_at
        self._error = error
        self._real = {name: getattr(os, name) for name in self.OPERATIONS}

    @contextlib.contextmanager
    def mounted(self):
        with pytest.MonkeyPatch.context() as patch:
            for name in self.OPERATIONS:
                patch.setattr(os, name, self._operation(name))
            yield self

    def _operation(self, name):
        def operation(*args, **kwargs):
            failing, self.done = self.done == self._fails_at, self.done + 1
            if failing and name == "fsync":
                with contextlib.suppress(OSError):  # a folder has no half
                    os.ftruncate(args[0], os.fstat(args[0]).st_size // 2)
            if failing or (self._error is Dead and self.done > self._fails_at):
                raise self._error(28, "No space left on device")
            return self._real[name](*args, **kwargs)

        return operation


CONDITIONS = (Condition("wall_avoidance", "creative"), Condition("spot_finding", "random"))


def plan(robots):
    return Plan.of(Experiment(cohort_size=1, time_scale=0.0005), CONDITIONS, robots)


@pytest.fixture
def run(in_process):
    """Simulates robots in this process, a cohort each, as the command does.

    A checkpoint is written after each look at the clock. Returns the number of operations on the
    disk, and whether the run was finished.
    """

    def run(directory, robots, fails_at=10**9, error=Dead):
        with Disk(fails_at, error).mounted() as disk:
            try:
                planned(directory)
                simulate(directory, plan(robots), in_process(), save_every=0, quiet=True)
            except error:
                return disk.done, False
        return disk.done, True

    return run


@pytest.mark.slow
@pytest.mark.parametrize("error", [Dead, OSError])
@pytest.mark.parametrize("finished", [0, 1])
def test_a_run_can_fail_between_any_two_operations_and_then_again(error, finished, tmp_path, run):
    before, whole = tmp_path / "before", tmp_path / "whole"
    before.mkdir()
    if finished:
        run(before, finished)
    shutil.copytree(before, whole)
    operations, ended = run(whole, finished + 1)
    assert ended
    undisturbed = contents(whole)
    moments = random.Random(0)
    survived = 0
    for operation in range(operations):
        directory = tmp_path / str(operation)
        shutil.copytree(before, directory)
        survived += run(directory, finished + 1, operation, error)[1]
        run(directory, finished + 1, moments.randrange(operations), error)
        assert run(directory, finished + 1)[1]
        message = f"failed at operation {operation} of {operations}"
        assert contents(directory) == undisturbed, message
        shutil.rmtree(directory)
    # A run survives a failure to make a folder that is there, or to remove an empty one.
    assert survived < operations / 4 if error is OSError else not survived


# At any moment

# The command, forked from one process that has imported everything: kills then fall into
# simulations, not into imports.
FORKS = """
import json, os, sys
from multiprocessing import get_context
from musebot.protocols import cli
from musebot.protocols.simulation import local

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
            stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=log.open("w"), text=True,
        )  # fmt: skip
        self._numbers = queue.Queue()
        threading.Thread(target=self._read, daemon=True).start()

    def _read(self):
        for line in self._process.stdout:
            self._numbers.put(int(line))

    def run(self, arguments, kill_after=None):
        """Returns the exit status of a command, -9 if seconds after its start a kill hit it."""
        self._process.stdin.write(json.dumps(arguments) + "\n")
        self._process.stdin.flush()
        session = self._numbers.get()
        try:
            status = self._numbers.get(timeout=kill_after)
        except queue.Empty:
            with contextlib.suppress(ProcessLookupError):  # it has ended, or not yet begun
                os.killpg(session, signal.SIGKILL)
            status = self._numbers.get()
        for _ in range(200):  # the last of its processes may still be dying
            try:
                os.killpg(session, 0)
            except ProcessLookupError:
                return status
            time.sleep(0.05)
        raise AssertionError(f"its processes are still there: {self._log.read_text()}")

    def close(self):
        self._process.stdin.close()
        self._process.wait()


@pytest.fixture
def commands(tmp_path):
    crew = Commands(tmp_path / "log")
    yield crew
    crew.close()


def held(directory):
    """Returns what a kill left of a run: nothing, checkpoints, or finished cohorts too."""
    kept = [path.name for path in directory.glob("checkpoints/[!.]*")]
    if any(name.endswith(".finished.safetensors") for name in kept):
        return "finished"
    return "checkpoints" if kept else "nothing"


@pytest.mark.slow
def test_a_run_killed_at_twenty_random_moments_leaves_the_undisturbed_runs_bytes(
    commands, tmp_path
):
    def run(directory, kill_after=None):
        words = "--robots 4 --cohort-size 2 --time-scale 0.005 --processes 2 --save-every 0.05"
        conditions = "--task wall_avoidance --proposer creative fixed"
        arguments = ["run", str(directory), *words.split(), *conditions.split()]
        return commands.run(arguments, kill_after)

    began = time.monotonic()
    assert run(tmp_path / "whole") == 0
    seconds = time.monotonic() - began
    undisturbed = contents(tmp_path / "whole")
    moments = random.Random(0)
    met = []  # by kills that hit a run in progress
    while len(met) < 20:
        directory = tmp_path / str(len(met))
        began, before, latest = time.monotonic(), len(met), seconds
        while (status := run(directory, moments.uniform(0, latest))) == -signal.SIGKILL:
            met.append(held(directory))
            latest *= 1.25  # so that it ends however busy the machine is
        if len(met) == before:
            seconds = time.monotonic() - began
        assert status == 0
        assert contents(directory) == undisturbed, f"after {met}"
        shutil.rmtree(directory)
    assert met.count("checkpoints") + met.count("finished") >= 10, met
    assert {"checkpoints", "finished"} <= set(met), met
