"""A run is the same run however it is cut, killed, spread over processes or added to."""

import collections
import itertools
import json
import os
import queue
import random
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from musebot.protocols import storage
from musebot.protocols.errors import InputError, Interrupted
from musebot.protocols.experiment.experiment import CohortKey, Experiment, Plan, named_brain
from musebot.protocols.results.results import BRAINS, CURVES, ROBOTS
from musebot.protocols.simulation import engine
from musebot.protocols.simulation.cohort import Cohort
from musebot.protocols.simulation.local import Processes

FILES = (ROBOTS, CURVES, BRAINS)
BOTH = (("wall_avoidance", "creative"), ("spot_finding", "random"))


def contents(directory):
    return {name: (Path(directory) / name).read_bytes() for name in FILES}


def plan(robots=4, conditions=BOTH, **changes):
    settings = {"cohort_size": 2, "time_scale": 0.004} | changes
    return Plan.of(Experiment(**settings), conditions, robots)


def live(directory, the_plan, processes=2):
    return engine.run(Path(directory), the_plan, Processes(processes), quiet=True)


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    directory = tmp_path_factory.mktemp("whole") / "run"
    live(directory, plan())
    return directory


def test_a_run_leaves_what_it_promises(whole):
    left = {path.name for path in whole.iterdir()}
    assert left == {"experiment.json", *FILES}


def test_same_seed_same_bytes_whatever_the_number_of_processes(whole, tmp_path):
    live(tmp_path / "again", plan(), processes=1)
    assert contents(tmp_path / "again") == contents(whole)


def test_another_seed_gives_other_lives(whole, tmp_path):
    live(tmp_path / "other", plan(seed=2))
    assert contents(tmp_path / "other")[CURVES] != contents(whole)[CURVES]
    assert contents(tmp_path / "other")[BRAINS] != contents(whole)[BRAINS]


def test_a_life_does_not_depend_on_the_other_conditions(whole, tmp_path):
    alone = live(tmp_path / "alone", plan(conditions=BOTH[1:]))
    both = engine.load(whole)
    assert str(alone.robots) == str(both.of(*BOTH[1]))  # as text: NaN equals NaN
    for part, other in ((alone.curves, both.curves), (alone.brains, both.brains)):
        for name, array in part.items():
            np.testing.assert_array_equal(array, other[name])


def test_robots_added_to_a_finished_run_are_new_cohorts_and_the_old_stay(whole, tmp_path):
    live(tmp_path / "grown", plan(robots=2))
    live(tmp_path / "grown", plan(robots=4))
    assert contents(tmp_path / "grown") == contents(whole)


def test_conditions_can_be_added_to_a_finished_run(whole, tmp_path):
    live(tmp_path / "grown", plan(conditions=BOTH[1:]))
    live(tmp_path / "grown", plan())
    assert contents(tmp_path / "grown") == contents(whole)


def test_a_finished_run_is_not_lived_again(whole):
    def refuse(*_):
        raise AssertionError("it lives again")

    before = contents(whole)
    engine.run(whole, plan(), refuse, quiet=True)
    assert contents(whole) == before


@pytest.mark.parametrize("brain", ["paper", "steady"])
@pytest.mark.parametrize("proposer", ["fixed", "random", "creative"])
@pytest.mark.parametrize("task", ["wall_avoidance", "spot_finding"])
def test_a_restored_cohort_goes_on_to_the_same_bits(task, proposer, brain):
    experiment = Experiment(cohort_size=3, time_scale=0.01, brain=named_brain(brain))
    key = CohortKey(task, proposer, 0)
    straight, cut = Cohort(experiment, key), Cohort(experiment, key)
    straight.advance(10**9)
    steps = random.Random(0)
    while not cut.finished:
        cut.advance(steps.randrange(1, 400))
        arrays, notes = cut.checkpoint()
        arrays = {name: array.copy() for name, array in arrays.items()}
        cut = Cohort(experiment, key)
        cut.restore(arrays, notes)
    for first, second in zip(straight.checkpoint(), cut.checkpoint(), strict=True):
        np.testing.assert_equal(first, second)


def command(directory, *more):
    return [
        sys.executable, "-m", "musebot", "run", str(directory), "--robots", "4",
        "--cohort-size", "2", "--time-scale", "0.02", "--processes", "2",
        "--task", "wall_avoidance", "--proposer", "creative", "fixed", *more,
    ]  # fmt: skip


LONGER = plan(
    conditions=(("wall_avoidance", "fixed"), ("wall_avoidance", "creative")), time_scale=0.02
)


@pytest.fixture(scope="module")
def undisturbed(tmp_path_factory):
    directory = tmp_path_factory.mktemp("undisturbed") / "run"
    live(directory, LONGER)
    return contents(directory)


def started(directory):
    process = subprocess.Popen(
        command(directory, "--save-every", "0.3"),
        stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, start_new_session=True,
    )  # fmt: skip
    return process


def wait_for_checkpoints(directory, process, seconds=300):
    for _ in range(seconds * 20):
        if any((Path(directory) / "checkpoints").glob("*.safetensors")):
            return
        assert process.poll() is None, process.stdout.read()
        time.sleep(0.05)
    raise AssertionError("no checkpoint was written")


@pytest.mark.parametrize("how", [signal.SIGINT, signal.SIGTERM])
def test_a_stopped_run_says_so_and_resumes_to_the_same_bytes(how, tmp_path, undisturbed):
    process = started(tmp_path / "run")
    wait_for_checkpoints(tmp_path / "run", process)
    os.killpg(process.pid, how)
    output = process.communicate(timeout=300)[0]
    assert process.returncode == 130, output
    assert "the same command goes on from here" in output
    assert not (tmp_path / "run" / ROBOTS).exists()
    live(tmp_path / "run", LONGER)
    assert contents(tmp_path / "run") == undisturbed


def test_a_killed_run_leaves_no_process_behind_and_resumes_to_the_same_bytes(tmp_path, undisturbed):
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
        raise AssertionError("its processes live on")
    live(tmp_path / "run", LONGER)
    assert contents(tmp_path / "run") == undisturbed


@pytest.mark.skipif(os.geteuid() != 0, reason="needs root to mount a small file system")
def test_a_full_disk_is_one_sentence_and_the_run_goes_on_once_there_is_room(tmp_path, undisturbed):
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
        run = subprocess.run(
            command(disk / "run", "--save-every", "0.3"),
            capture_output=True,
            text=True,
            check=False,
        )
        assert run.returncode == 1
        assert "a file could not be written" in run.stderr
        assert "No space left" in run.stderr
        assert "Traceback" not in run.stderr
        ballast.unlink()
        subprocess.run(["mount", "-o", "remount,size=64m", str(disk)], check=True)
        live(disk / "run", LONGER)
        assert contents(disk / "run") == undisturbed
    finally:
        subprocess.run(["umount", str(disk)], check=True)


@pytest.mark.parametrize("damage", ["truncated", "altered"])
def test_a_damaged_checkpoint_is_named_set_aside_and_its_cohort_lived_again(
    damage, tmp_path, undisturbed, capfd
):
    directory = tmp_path / "run"
    process = started(directory)
    wait_for_checkpoints(directory, process)
    os.killpg(process.pid, signal.SIGTERM)
    process.communicate(timeout=300)
    victim = sorted((directory / "checkpoints").glob("*.safetensors"))[0]
    whole = victim.read_bytes()
    half = len(whole) // 2
    altered = whole[:half] + bytes([whole[half] ^ 1]) + whole[half + 1 :]
    victim.write_bytes(whole[:half] if damage == "truncated" else altered)
    run = subprocess.run(command(directory), capture_output=True, text=True, check=False)
    assert run.returncode == 0, run.stderr
    told = " ".join((run.stdout + run.stderr).split())
    assert victim.name in told.replace(" ", "") or victim.stem in told.replace(" ", "")
    assert contents(directory) == undisturbed


class Here:
    """Lives cohorts in this process, and stops after some."""

    def __init__(self, most=10**9):
        self.most = most
        self.jobs = []

    @property
    def keys(self):
        return [job.key for job in self.jobs]

    def __call__(self, jobs, display):
        for job in jobs:
            if len(self.jobs) == self.most:
                raise Interrupted
            assert engine.live(job, lambda: False, lambda step, message: None)
            self.jobs.append(job)
            yield job


def finish(directory, monkeypatch):
    """Takes a run up; returns which cohorts it lived, and how often it read each file."""
    reads = collections.Counter()

    def load_arrays(path):
        reads[path.name] += path.exists()
        return storage.load_arrays(path)

    here = Here()
    monkeypatch.setattr(engine, "load_arrays", load_arrays)
    engine.run(directory, plan(), here, quiet=True)
    return here.keys, +reads


def test_a_cohort_that_was_finished_is_not_lived_again_and_read_once(whole, tmp_path, monkeypatch):
    early = Here(most=3)
    with pytest.raises(Interrupted):
        engine.run(tmp_path, plan(), early, quiet=True)
    keys, reads = finish(tmp_path, monkeypatch)
    assert sorted(map(str, early.keys + keys)) == sorted(map(str, plan().cohorts()))
    assert reads == {f"{key}.finished.safetensors": 1 for key in plan().cohorts()}
    assert contents(tmp_path) == contents(whole)


def test_a_damaged_finished_cohort_is_named_set_aside_and_lived_again(whole, tmp_path, capfd):
    early = Here(most=1)
    with pytest.raises(Interrupted):
        engine.run(tmp_path, plan(), early, quiet=True)
    victim = engine.finished_file(tmp_path, early.keys[0])
    victim.write_bytes(victim.read_bytes()[:-1])
    here = Here()
    engine.run(tmp_path, plan(), here)
    assert sorted(map(str, here.keys)) == sorted(map(str, plan().cohorts()))
    assert victim.name in capfd.readouterr().err.replace("\n", "")
    assert victim.with_suffix(".damaged").exists()
    assert contents(tmp_path) == contents(whole)


def test_runs_lived_together_are_the_runs_lived_alone_after_whichever_cohort_they_are_cut(
    whole, tmp_path
):
    live(tmp_path / "alone", plan(seed=2))
    plans = {tmp_path / "whole": plan(), tmp_path / "one": plan(), tmp_path / "two": plan(seed=2)}
    live(tmp_path / "whole", plan())
    lived = []
    for cut in itertools.count():
        here = Here(most=1)
        try:
            results = engine.run_all(plans, here, quiet=True)
        except Interrupted:
            pass
        lived += map(str, here.jobs)
        # A run is there once its own lives are, whatever becomes of the others.
        assert (tmp_path / "one" / ROBOTS).exists() == (cut >= 3)
        assert (tmp_path / "two" / ROBOTS).exists() == (cut >= 7)
        if cut == 7:
            break
    assert lived == [f"{run}/{key}" for run in ("one", "two") for key in plan().cohorts()]
    for directory, same in (("whole", whole), ("one", whole), ("two", tmp_path / "alone")):
        assert contents(tmp_path / directory) == contents(same)
        assert str(results[tmp_path / directory].robots) == str(engine.load(same).robots)
        assert not (tmp_path / directory / "checkpoints").exists()


def test_processes_live_runs_of_several_experiments(whole, tmp_path):
    other = plan(brain=named_brain("steady"), body="kinematic", cohort_size=4)
    live(tmp_path / "alone", other)
    plans = {tmp_path / "one": plan(), tmp_path / "two": other}
    engine.run_all(plans, Processes(2), quiet=True)
    assert contents(tmp_path / "one") == contents(whole)
    assert contents(tmp_path / "two") == contents(tmp_path / "alone")


def test_whoever_lives_is_told_to_stop_where_lives_cannot_be_put_together(tmp_path, monkeypatch):
    told, kept = [], []

    def workforce(jobs, display):
        try:
            for job in jobs:
                assert engine.live(job, lambda: False, lambda step, message: None)
                yield job
        except GeneratorExit:
            told.append(job)
            raise

    def refuse(directory, results):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(engine, "save", refuse)
    one = plan(robots=2, conditions=BOTH[:1])
    plans = {tmp_path / "one": one, tmp_path / "two": one}
    with pytest.raises(OSError, match="No space left"):
        engine.run_all(plans, lambda *them: kept.append(workforce(*them)) or kept[0], quiet=True)
    assert [job.directory.name for job in told] == ["one"]  # before the other began
    monkeypatch.undo()
    here = Here()
    engine.run_all(plans, here, quiet=True)
    assert [job.directory.name for job in here.jobs] == ["two"]
    assert contents(tmp_path / "one") == contents(tmp_path / "two")


def test_a_run_that_had_not_begun_tells_nothing_of_the_machine_that_stopped(tmp_path, monkeypatch):
    plans = {tmp_path / "one": plan(robots=2), tmp_path / "two": plan(robots=2)}
    with pytest.raises(Interrupted):
        engine.run_all(plans, Here(most=1), quiet=True)
    monkeypatch.setattr(os, "cpu_count", lambda: 1000)
    engine.run_all(plans, Here(), quiet=True)
    cores = [
        [made["cores"] for made in json.loads((directory / engine.PLAN).read_text())["made_with"]]
        for directory in plans
    ]
    assert len(cores[0]) == 2 and cores[0][1] == 1000 and cores[1] == [1000]


def test_progress_weighs_each_cohort_by_its_robots():
    few, many = plan(robots=2).experiment, plan(robots=40, cohort_size=40).experiment
    key = CohortKey(*BOTH[0], 0)
    jobs = [engine.Job(Path("few"), few, key, 60.0), engine.Job(Path("many"), many, key, 60.0)]
    reports = queue.Queue()
    with engine.Display(jobs, quiet=True) as display:
        (task,) = display._progress.tasks
        assert task.total == pytest.approx(42 * jobs[0].steps * 0.1)
        reports.put((1, 10, ""))
        display.show(reports)
        assert task.completed == pytest.approx(40 * 10 * 0.1)
        reports.put((0, 10, ""))
        display.show(reports)
        assert task.completed == pytest.approx(42 * 10 * 0.1)


def files(directory):
    return {path: path.read_bytes() for path in directory.rglob("*") if path.is_file()}


@pytest.mark.parametrize(
    ("what", "seed", "words"),
    [
        ("robots", 1, "damaged"),
        ("seed", 2, "the lives of two experiments cannot be merged"),
        ("physics", 1, "two was lived in another physics"),
    ],
)
def test_nothing_is_changed_where_one_of_several_runs_cannot_be_gone_on_with(
    what, seed, words, tmp_path
):
    one, two = tmp_path / "one", tmp_path / "two"
    early = Here(most=1)
    with pytest.raises(Interrupted):
        engine.run(one, plan(), early, quiet=True)
    engine.finished_file(one, early.keys[0]).write_bytes(b"damaged")
    engine.run(two, plan(conditions=BOTH[:1]), Here(), quiet=True)
    if what == "robots":
        (two / ROBOTS).write_text("damaged")
    if what == "physics":
        content = json.loads((two / engine.PLAN).read_text())
        content["physics"][0] += 1
        (two / engine.PLAN).write_text(json.dumps(content))
    before, here = files(tmp_path), Here()
    with pytest.raises(InputError, match=words):
        engine.run_all({one: plan(), two: plan(seed=seed)}, here, quiet=True)
    assert files(tmp_path) == before and here.jobs == []


def test_all_runs_are_locked_before_a_life_begins(tmp_path):
    here = Here()
    with (
        engine.locked(tmp_path / "other"),
        pytest.raises(InputError, match="another musebot is running in .*other"),
    ):
        engine.run_all({tmp_path / "one": plan(), tmp_path / "other": plan()}, here, quiet=True)
    assert here.jobs == []
    assert not (tmp_path / "one" / engine.PLAN).exists()


def test_two_runs_in_one_directory_are_refused(tmp_path):
    directory = tmp_path / "run"
    process = started(directory)
    wait_for_checkpoints(directory, process)
    try:
        with pytest.raises(InputError, match="another musebot is running"):
            live(directory, LONGER)
    finally:
        os.killpg(process.pid, signal.SIGKILL)
        process.communicate()


def test_an_unstable_life_is_reported_counted_and_the_others_live_on(tmp_path, monkeypatch):
    experiment, key = Experiment(cohort_size=3, time_scale=0.01), CohortKey(*BOTH[0], 0)
    sound, broken = Cohort(experiment, key), Cohort(experiment, key)
    sound.advance(100)
    broken.advance(100)
    broken.batch.arrays()["state"][1, 1] = np.nan
    monkeypatch.chdir(tmp_path)  # MuJoCo leaves its log in the working directory
    sound.advance(10**9)
    broken.advance(10**9)
    results = engine.collect(experiment, [(key, broken.lives())])
    assert [r.category == "invalid" for r in results.robots] == [False, True, False]
    assert results.summary(experiment, *BOTH[0]).invalid == 1
    assert results.summary(experiment, *BOTH[0]).robots == 2
    engine.save(tmp_path, results)
    read = engine.load(tmp_path).robots
    assert [r.category for r in read] == [r.category for r in results.robots]
