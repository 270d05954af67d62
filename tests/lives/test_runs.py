"""A run leaves the same bytes however it is stopped, spread over processes or enlarged."""

import collections
import dataclasses
import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from helpers import files_below

from musebot.controller import BRAINS
from musebot.protocols import storage
from musebot.protocols.errors import InputError, Interrupted
from musebot.protocols.lives import checkpoints
from musebot.protocols.lives.checkpoints import checkpoint_file, finished_file
from musebot.protocols.lives.cohort import Cohort
from musebot.protocols.lives.conditions import CohortKey, Condition
from musebot.protocols.lives.experiment import Experiment
from musebot.protocols.lives.jobs import CohortJob
from musebot.protocols.lives.local import Local
from musebot.protocols.lives.manifest import MANIFEST, write_manifest
from musebot.protocols.lives.plan import Plan
from musebot.protocols.lives.run import Run, joined, results_of
from musebot.protocols.lives.run_files import (
    RESULTS_FILE,
    ROBOTS_FILE,
    read_run,
    write_results,
)
from musebot.protocols.lives.runs import UnfinishedRun, simulate
from musebot.protocols.storage import locked, write_json

FILES = (ROBOTS_FILE, RESULTS_FILE)
BOTH = (Condition("wall_avoidance", "creative"), Condition("spot_finding", "random"))


def contents(directory):
    return {name: (Path(directory) / name).read_bytes() for name in FILES}


def plan(robots=4, conditions=BOTH, **changes):
    settings = {"cohort_size": 2, "time_scale": 0.004} | changes
    return Plan.of(Experiment(**settings), conditions, robots)


@pytest.fixture(scope="module")
def run(in_process):
    """Simulates robots in this process, or by another executor."""

    def run(directory, the_plan, executor=None):
        return simulate(Path(directory), the_plan, executor or in_process(), quiet=True)

    return run


@pytest.fixture(scope="module")
def whole(run, tmp_path_factory):
    """A finished run of `plan()`."""
    directory = tmp_path_factory.mktemp("whole") / "run"
    run(directory, plan())
    return directory


def test_a_run_leaves_its_manifest_and_its_results_only(whole):
    assert {path.name for path in whole.iterdir()} == {MANIFEST, *FILES}


def test_a_run_returns_what_its_files_hold(run, whole, tmp_path):
    returned = run(tmp_path / "run", plan())
    read = read_run(tmp_path / "run")
    assert (returned.name, returned.experiment) == ("run", plan().experiment)
    assert (read.name, read.experiment) == ("run", plan().experiment)
    assert_same(returned, read)


def test_the_same_seed_leaves_the_same_bytes_with_any_number_of_processes(run, whole, tmp_path):
    for processes in (1, 2):
        run(tmp_path / str(processes), plan(), Local(processes))
        assert contents(tmp_path / str(processes)) == contents(whole)


def test_another_seed_gives_other_lives(run, whole, tmp_path):
    run(tmp_path / "other", plan(seed=2))
    assert contents(tmp_path / "other")[ROBOTS_FILE] != contents(whole)[ROBOTS_FILE]


def assert_same(first: Run, second: Run):
    assert first.conditions() == second.conditions()
    for condition in first.conditions():
        one, other = first.results[condition], second.results[condition]
        assert str(one.robots) == str(other.robots)  # as text: NaN equals NaN
        np.testing.assert_array_equal(one.curves, other.curves)
        np.testing.assert_equal(one.networks, other.networks)


def test_a_life_does_not_depend_on_the_other_conditions(run, whole, tmp_path):
    alone = run(tmp_path / "alone", plan(conditions=BOTH[1:]))
    both = read_run(whole)
    assert alone.conditions() == [BOTH[1]]
    assert_same(alone, Run("", both.experiment, {BOTH[1]: both.results[BOTH[1]]}))


def test_robots_added_to_a_finished_run_are_new_cohorts_and_the_old_ones_stay(run, whole, tmp_path):
    run(tmp_path / "grown", plan(robots=2))
    run(tmp_path / "grown", plan(robots=4))
    assert contents(tmp_path / "grown") == contents(whole)


def test_conditions_can_be_added_to_a_finished_run(run, whole, tmp_path):
    run(tmp_path / "grown", plan(conditions=BOTH[1:]))
    run(tmp_path / "grown", plan())
    assert contents(tmp_path / "grown") == contents(whole)


def test_a_run_that_has_more_robots_than_the_plan_keeps_them(run, whole):
    before = contents(whole)
    larger = run(whole, plan(robots=2, conditions=BOTH[:1]))
    assert [len(larger.robots(condition)) for condition in BOTH] == [4, 4]
    assert contents(whole) == before


@pytest.mark.parametrize(
    "changes",
    [
        {"context_neurons": 2},
        {"context_neurons": 10, "initial_range": 0.2},
    ],
)
def test_arrays_that_are_not_drawn_from_the_initial_interval_are_sound(changes, run, tmp_path):
    brain = dataclasses.replace(BRAINS["steady"], **changes)
    own = plan(4, [Condition("spot_finding", "creative")], brain=brain)
    first = run(tmp_path / "out", own)
    again = run(tmp_path / "out", own)  # reads the finished files
    assert_same(first, again)


def test_a_finished_run_is_not_simulated_again_and_says_so(whole, capsys):
    def refuse(*_):
        raise AssertionError("it simulates again")

    before = contents(whole)
    simulate(whole, plan(), refuse)
    assert contents(whole) == before
    words = "is finished (all durations times 0.004; another folder starts another run), so nothing"
    assert words in capsys.readouterr().err


# Processes that are stopped or killed


def command(directory, *more):
    return [
        sys.executable, "-m", "musebot", "run", str(directory), "--robots", "4",
        "--cohort-size", "2", "--time-scale", "0.02", "--processes", "2",
        "--task", "wall_avoidance", "--proposer", "creative", "fixed", *more,
    ]  # fmt: skip


LONGER = plan(
    conditions=[Condition("wall_avoidance", proposer) for proposer in ("fixed", "creative")],
    time_scale=0.02,
)


@pytest.fixture(scope="module")
def undisturbed(run, tmp_path_factory):
    """The files of a run of `LONGER` that was not stopped."""
    directory = tmp_path_factory.mktemp("undisturbed") / "run"
    run(directory, LONGER)
    return contents(directory)


def started(directory):
    return subprocess.Popen(
        command(directory, "--save-every", "0.3"),
        stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, start_new_session=True,
    )  # fmt: skip


def wait_for_checkpoints(directory, process, seconds=300):
    for _ in range(seconds * 20):
        if any((Path(directory) / "checkpoints").glob("*.safetensors")):
            return
        assert process.poll() is None, process.stdout.read()
        time.sleep(0.05)
    raise AssertionError("no checkpoint was written")


@pytest.mark.parametrize("how", [signal.SIGINT, signal.SIGTERM])
def test_a_stopped_run_says_so_and_resumes_to_the_same_bytes(run, how, tmp_path, undisturbed):
    process = started(tmp_path / "run")
    wait_for_checkpoints(tmp_path / "run", process)
    os.killpg(process.pid, how)
    output = process.communicate(timeout=300)[0]
    assert process.returncode == 130, output
    assert "stopped; the same command continues from here" in output
    assert not (tmp_path / "run" / ROBOTS_FILE).exists()
    run(tmp_path / "run", LONGER)
    assert contents(tmp_path / "run") == undisturbed


def test_a_killed_run_leaves_no_process_and_resumes_to_the_same_bytes(run, tmp_path, undisturbed):
    process = started(tmp_path / "run")
    wait_for_checkpoints(tmp_path / "run", process)
    group = os.getpgid(process.pid)
    process.kill()
    process.communicate()
    for _ in range(100):
        try:
            os.killpg(group, 0)
        except ProcessLookupError:
            break
        time.sleep(0.1)
    else:
        os.killpg(group, signal.SIGKILL)
        raise AssertionError("its processes are still there")
    run(tmp_path / "run", LONGER)
    assert contents(tmp_path / "run") == undisturbed


@pytest.mark.skipif(os.geteuid() != 0, reason="needs root to mount a small file system")
def test_a_full_disk_is_one_sentence_and_the_run_continues_once_there_is_room(
    run, tmp_path, undisturbed
):
    disk = tmp_path / "disk"
    disk.mkdir()
    mounted = subprocess.run(
        ["mount", "-t", "tmpfs", "-o", "size=1m", "tmpfs", str(disk)], check=False
    )
    if mounted.returncode:
        pytest.skip("no small file system can be mounted here")
    try:
        ballast = disk / "ballast"
        ballast.write_bytes(bytes(900 * 1024))
        failed = subprocess.run(
            command(disk / "run", "--save-every", "0.3"),
            capture_output=True,
            text=True,
            check=False,
        )
        assert failed.returncode == 1
        assert "a file could not be read or written" in failed.stderr
        assert "No space left" in failed.stderr
        assert "Traceback" not in failed.stderr
        ballast.unlink()
        subprocess.run(["mount", "-o", "remount,size=64m", str(disk)], check=True)
        run(disk / "run", LONGER)
        assert contents(disk / "run") == undisturbed
    finally:
        subprocess.run(["umount", str(disk)], check=True)


@pytest.mark.parametrize("damage", ["truncated", "altered"])
def test_a_damaged_checkpoint_is_named_set_aside_and_its_cohort_starts_anew(
    damage, tmp_path, whole, capfd, in_process
):
    key = plan().cohorts()[0]
    looks = iter([False, True])  # before the first steps, then stop
    assert not CohortJob(tmp_path, plan().experiment, (key,), 60).run(
        lambda: next(looks), lambda done, message: None
    )
    write_manifest(tmp_path, plan())
    victim = checkpoint_file(tmp_path, key)
    content = victim.read_bytes()
    half = len(content) // 2
    altered = content[:half] + bytes([content[half] ^ 1]) + content[half + 1 :]
    victim.write_bytes(content[:half] if damage == "truncated" else altered)
    messages = []

    def executor(jobs, progress):
        for job in jobs:
            assert job.run(lambda: False, lambda done, message: messages.append(message))
            yield job

    simulate(tmp_path, plan(), executor, quiet=True)
    [message] = filter(None, messages)
    assert victim.name in message
    assert "set aside" in message
    assert victim.with_suffix(".damaged").exists()
    assert contents(tmp_path) == contents(whole)


# What an earlier call finished


def keys(executor):
    return [job.keys[0] for job in executor.jobs]


def test_a_finished_cohort_is_not_simulated_again_and_is_read_once(
    whole, tmp_path, monkeypatch, in_process
):
    early, late = in_process(most=3), in_process()
    with pytest.raises(Interrupted):
        simulate(tmp_path, plan(), early, quiet=True)
    reads = collections.Counter()

    def load_arrays(path, check):
        reads[path.name] += path.exists()
        return storage.load_arrays(path, check)

    monkeypatch.setattr(checkpoints, "load_arrays", load_arrays)
    simulate(tmp_path, plan(), late, quiet=True)
    assert sorted(keys(early) + keys(late)) == sorted(plan().cohorts())
    assert +reads == {f"{key}.finished.safetensors": 1 for key in plan().cohorts()}
    assert contents(tmp_path) == contents(whole)


def test_a_damaged_finished_cohort_is_named_set_aside_and_starts_anew(
    whole, tmp_path, capfd, in_process
):
    early, late = in_process(most=1), in_process()
    with pytest.raises(Interrupted):
        simulate(tmp_path, plan(), early, quiet=True)
    victim = finished_file(tmp_path, keys(early)[0])
    victim.write_bytes(victim.read_bytes()[:-1])
    simulate(tmp_path, plan(), late)
    assert sorted(keys(late)) == sorted(plan().cohorts())
    assert victim.name in capfd.readouterr().err.replace("\n", "")
    assert victim.with_suffix(".damaged").exists()
    assert contents(tmp_path) == contents(whole)


def test_results_are_written_once_the_last_cohort_is_finished(tmp_path, in_process):
    cohorts = len(plan().cohorts())
    for done in range(1, cohorts + 1):
        assert not (tmp_path / RESULTS_FILE).exists()
        executor = in_process(most=1)
        try:
            simulate(tmp_path, plan(), executor, quiet=True)
        except Interrupted:
            assert done < cohorts
    assert (tmp_path / ROBOTS_FILE).exists()
    assert not (tmp_path / "checkpoints").exists()


def test_the_executor_is_closed_where_results_cannot_be_written(tmp_path, monkeypatch, in_process):
    closed = []

    def executor(jobs, progress):
        try:
            yield from in_process()(jobs, progress)
        except GeneratorExit:
            closed.append(True)
            raise

    def refuse(directory, experiment, measured):
        raise OSError(28, "No space left on device")

    one = plan(robots=2, conditions=BOTH[:1])
    with monkeypatch.context() as patch:
        patch.setattr("musebot.protocols.lives.runs.write_results", refuse)
        with pytest.raises(OSError, match="No space left"):
            simulate(tmp_path, one, executor, quiet=True)
    assert closed == [True]
    late = in_process()
    simulate(tmp_path, one, late, quiet=True)
    assert late.jobs == []  # the cohort's file was kept
    assert (tmp_path / ROBOTS_FILE).exists()


def test_a_run_that_had_not_begun_forgets_the_machine_that_stopped(tmp_path, monkeypatch):
    def refuse(jobs, progress):
        raise Interrupted
        yield

    def cores():
        return [
            made["cores"] for made in json.loads((tmp_path / MANIFEST).read_text())["made_with"]
        ]

    with pytest.raises(Interrupted):
        simulate(tmp_path, plan(robots=2), refuse, quiet=True)
    assert cores() == [os.cpu_count()]
    monkeypatch.setattr(os, "cpu_count", lambda: 1000)
    with pytest.raises(Interrupted):
        simulate(tmp_path, plan(robots=2), refuse, quiet=True)
    assert cores() == [1000]


def test_a_run_that_had_begun_names_both_machines(tmp_path, monkeypatch, in_process):
    here = os.cpu_count()
    with pytest.raises(Interrupted):
        simulate(tmp_path, plan(robots=2), in_process(most=1), quiet=True)
    monkeypatch.setattr(os, "cpu_count", lambda: 1000)
    simulate(tmp_path, plan(robots=2), in_process(), quiet=True)
    made_with = json.loads((tmp_path / MANIFEST).read_text())["made_with"]
    assert [made["cores"] for made in made_with] == [here, 1000]


# Runs that are refused


@pytest.mark.parametrize(
    ("what", "seed", "words"),
    [
        ("robots", 1, "damaged"),
        ("seed", 2, "the robots of two experiments cannot be merged"),
        ("physics", 1, "was simulated in another physics"),
    ],
)
def test_nothing_is_changed_in_a_run_that_cannot_be_continued(
    what, seed, words, tmp_path, in_process
):
    directory = tmp_path / "run"
    simulate(directory, plan(conditions=BOTH[:1]), in_process(), quiet=True)
    with pytest.raises(Interrupted):
        simulate(directory, plan(), in_process(most=1), quiet=True)
    if what == "robots":
        (directory / RESULTS_FILE).write_text("damaged")
    if what == "physics":
        content = json.loads((directory / MANIFEST).read_text())
        content["physics"][0] += 1
        write_json(directory / MANIFEST, content)
    before, executor = files_below(tmp_path), in_process()
    with pytest.raises(InputError, match=words):
        simulate(directory, plan(seed=seed), executor, quiet=True)
    assert files_below(tmp_path) == before and executor.jobs == []


def test_a_finished_run_of_another_physics_can_be_read(tmp_path, in_process):
    simulate(tmp_path, plan(robots=2), in_process(), quiet=True)
    content = json.loads((tmp_path / MANIFEST).read_text())
    content["physics"][0] += 1
    write_json(tmp_path / MANIFEST, content)
    executor = in_process()
    simulate(tmp_path, plan(robots=2), executor, quiet=True)
    assert executor.jobs == []


def test_a_locked_folder_is_refused_before_anything_is_written(tmp_path, in_process):
    executor = in_process()
    with (
        locked(tmp_path / "run"),
        pytest.raises(InputError, match="another musebot is running in .*run"),
    ):
        simulate(tmp_path / "run", plan(), executor, quiet=True)
    assert executor.jobs == []
    assert not (tmp_path / "run" / MANIFEST).exists()


def test_a_plan_that_the_machine_cannot_hold_is_refused_before_it_is_begun(tmp_path, monkeypatch):
    monkeypatch.setattr("musebot.protocols.lives.budget.machine_bytes", lambda: 10**6)
    large = Plan.of(Experiment(cohort_size=1000), BOTH, 1000)
    with pytest.raises(InputError, match="would need about .* of memory; this machine has"):
        simulate(tmp_path / "new", large, Local(1), quiet=True)
    assert [*tmp_path.iterdir()] == []


def test_a_finished_run_needs_no_memory_and_no_device(tmp_path, monkeypatch, in_process):
    simulate(tmp_path, plan(robots=2), in_process(), quiet=True)
    monkeypatch.setattr("musebot.protocols.lives.budget.machine_bytes", lambda: 10)
    monkeypatch.setattr("musebot.protocols.lives.runs.check_device", pytest.fail)
    executor = in_process()
    assert simulate(tmp_path, plan(robots=2), executor, quiet=True).results.keys() == {*BOTH}
    assert executor.jobs == []


def test_cohorts_of_two_versions_of_an_agent_do_not_join(tmp_path):
    lives = Cohort(Experiment(cohort_size=2, time_scale=0.004), CohortKey(BOTH[1], 0)).lives()
    run = UnfinishedRun.read(tmp_path / "run", plan(conditions=BOTH[1:], robots=6))
    run._add(CohortKey(BOTH[1], 0), lives)
    run._add(CohortKey(BOTH[1], 1), lives)
    doubled = {name: array.astype(float) for name, array in lives.after.items()}
    other = dataclasses.replace(lives, after=doubled)
    with pytest.raises(InputError, match="random-0002 keeps other weights than the robots"):
        run._add(CohortKey(BOTH[1], 2), other)


# Unstable simulations


def test_an_unstable_robot_is_counted_as_invalid_and_the_others_are_not(tmp_path, monkeypatch):
    experiment, key = Experiment(cohort_size=3, time_scale=0.01), CohortKey(BOTH[0], 0)
    sound, broken = Cohort(experiment, key), Cohort(experiment, key)
    sound.advance(100)
    broken.advance(100)
    broken.batch.arrays()["state"][1, 1] = np.nan
    monkeypatch.chdir(tmp_path)  # MuJoCo leaves its log in the working directory
    sound.advance(10**9)
    broken.advance(10**9)
    measured = joined({}, [(key, broken.lives())])
    results = results_of(experiment, measured)
    robots = results[BOTH[0]].robots
    assert [robot.category == "invalid" for robot in robots] == [False, True, False]
    summary = Run("run", experiment, results).summary(BOTH[0])
    assert summary.invalid == 1
    assert summary.robots == 2
    for name in ("events", "minutes"):
        ours, theirs = getattr(broken.lives(), name), getattr(sound.lives(), name)
        np.testing.assert_array_equal(ours[[0, 2]], theirs[[0, 2]])
    write_manifest(tmp_path, Plan.of(experiment, BOTH[:1], experiment.cohort_size))
    write_results(tmp_path, experiment, measured)
    read = read_run(tmp_path).robots(BOTH[0])
    assert [robot.category for robot in read] == [robot.category for robot in robots]
