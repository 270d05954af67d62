"""Wherever a run dies, the same command takes it up and leaves the undisturbed run's bytes."""

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

from musebot.protocols.experiment.experiment import Experiment, Plan
from musebot.protocols.results.results import BRAINS, CURVES, ROBOTS
from musebot.protocols.simulation import engine

FILES = {ROBOTS, CURVES, BRAINS}


def contents(directory):
    """What a finished run leaves, and proof that it leaves nothing else but its tables."""
    left = {path.name for path in directory.iterdir()}
    assert left - {"tables.md"} == {engine.PLAN, *FILES}
    return {name: (directory / name).read_bytes() for name in FILES}


# Between any two things that are done to the disk


class Dead(BaseException):
    """The process is no more: nothing catches this, and nothing is cleaned up after it."""


class Disk:
    """Counts what is done to the disk, and fails at the n-th deed.

    A process that is killed there does nothing more, and leaves half a file where it was
    writing one; one that is refused there goes on with what it does then.
    """

    DEEDS = ("fsync", "mkdir", "replace", "rmdir", "unlink")

    def __init__(self, fails_at, error):
        self.done = 0
        self._fails_at = fails_at
        self._error = error
        self._real = {name: getattr(os, name) for name in self.DEEDS}

    @contextlib.contextmanager
    def mounted(self):
        with pytest.MonkeyPatch.context() as patch:
            for name in self.DEEDS:
                patch.setattr(os, name, self._deed(name))
            yield self

    def _deed(self, name):
        def deed(*args, **kwargs):
            failing, self.done = self.done == self._fails_at, self.done + 1
            if failing and name == "fsync":
                with contextlib.suppress(OSError):  # a folder has no half
                    os.ftruncate(args[0], os.fstat(args[0]).st_size // 2)
            if failing or (self._error is Dead and self.done > self._fails_at):
                raise self._error(28, "No space left on device")
            return self._real[name](*args, **kwargs)

        return deed


def live_here(jobs, display):
    """Lives cohorts in this process, a checkpoint after each look at the clock."""
    for job in jobs:
        assert engine.live(job, stop=lambda: False, report=lambda step, message: None)
        yield job


CONDITIONS = (("wall_avoidance", "creative"), ("spot_finding", "random"))


def plan(robots):
    return Plan.of(Experiment(cohort_size=1, time_scale=0.0005), CONDITIONS, robots)


def live(directory, robots, fails_at=10**9, error=Dead):
    """Lives robots, a cohort each, as the command does.

    Returns:
      How many deeds were done to the disk, and whether the run came to its end.
    """
    with Disk(fails_at, error).mounted() as disk:
        try:
            engine.open_directory(directory)
            engine.run(directory, plan(robots), live_here, save_every=0, quiet=True)
        except error:
            return disk.done, False
    return disk.done, True


@pytest.mark.slow
@pytest.mark.parametrize("error", [Dead, OSError])
@pytest.mark.parametrize("lived", [0, 1])
def test_a_run_can_fail_between_any_two_deeds_and_then_again(error, lived, tmp_path):
    before, whole = tmp_path / "before", tmp_path / "whole"
    before.mkdir()
    if lived:
        live(before, lived)
    shutil.copytree(before, whole)
    deeds, ended = live(whole, lived + 1)
    assert ended
    undisturbed = contents(whole)
    moments = random.Random(0)
    survived = 0
    for deed in range(deeds):
        directory = tmp_path / str(deed)
        shutil.copytree(before, directory)
        survived += live(directory, lived + 1, deed, error)[1]
        live(directory, lived + 1, moments.randrange(deeds), error)
        assert live(directory, lived + 1)[1]
        assert contents(directory) == undisturbed, f"failed at deed {deed} of {deeds}"
        shutil.rmtree(directory)
    # What a run can do without: that a folder is made which is there, or goes once it is empty.
    assert survived < deeds / 4 if error is OSError else not survived


def live_both(directory, fails_at=10**9, error=Dead):
    """Lives two runs together, a cohort each; returns what `live` does."""
    plans = {
        directory / name: Plan.of(Experiment(cohort_size=1, time_scale=0.0005, seed=seed), [c], 1)
        for name, seed, c in (("one", 1, CONDITIONS[0]), ("two", 2, CONDITIONS[1]))
    }
    with Disk(fails_at, error).mounted() as disk:
        try:
            engine.run_all(plans, live_here, save_every=0, quiet=True)
        except error:
            return disk.done, False
    return disk.done, True


@pytest.mark.slow
@pytest.mark.parametrize("error", [Dead, OSError])
def test_runs_that_live_together_can_fail_between_any_two_deeds(error, tmp_path):
    deeds, ended = live_both(tmp_path / "whole")
    assert ended
    undisturbed = [contents(tmp_path / "whole" / name) for name in ("one", "two")]
    survived = 0
    for deed in range(deeds):
        directory = tmp_path / str(deed)
        survived += live_both(directory, deed, error)[1]
        assert live_both(directory)[1]
        both = [contents(directory / name) for name in ("one", "two")]
        assert both == undisturbed, f"failed at deed {deed} of {deeds}"
        shutil.rmtree(directory)
    assert survived < deeds / 4 if error is OSError else not survived


# At any moment

# The command, forked again and again from one process that has imported everything: twenty
# kills then fall into lives, not into imports.
FORKS = """
import json, os, sys
from multiprocessing import get_context
from musebot.protocols import cli
from musebot.protocols.simulation import local as processes

processes.multiprocessing.get_context = lambda method: get_context("fork")
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
        raise AssertionError(f"its processes live on: {self._log.read_text()}")

    def close(self):
        self._process.stdin.close()
        self._process.wait()


@pytest.fixture
def commands(tmp_path):
    crew = Commands(tmp_path / "log")
    yield crew
    crew.close()


def held(directory):
    """What of a run a kill has met: nothing, checkpoints, or finished cohorts as well."""
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
            latest *= 1.25  # it comes to its end, however busy the machine has become meanwhile
        if len(met) == before:
            seconds = time.monotonic() - began
        assert status == 0
        assert contents(directory) == undisturbed, f"after {met}"
        shutil.rmtree(directory)
    assert met.count("checkpoints") + met.count("finished") >= 10, met
    assert {"checkpoints", "finished"} <= set(met), met
