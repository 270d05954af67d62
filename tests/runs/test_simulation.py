"""A run leaves the same bytes spread over processes or enlarged; tests/faults stops and kills."""

import dataclasses
import json
import os
import shutil
from pathlib import Path

import numpy as np
import pytest
from helpers import change_physics, files_below

from musebot.protocols.agents.factory import trust
from musebot.protocols.agents.names import recorded_name
from musebot.protocols.errors import InputError, Interrupted, RunError
from musebot.protocols.runs import simulation
from musebot.protocols.runs.checkpoints import finished_file, save_lives
from musebot.protocols.runs.cohort import Cohort
from musebot.protocols.runs.conditions import Condition
from musebot.protocols.runs.experiment import Experiment
from musebot.protocols.runs.local import Local
from musebot.protocols.runs.manifest import MANIFEST, write_manifest
from musebot.protocols.runs.plan import Plan
from musebot.protocols.runs.run import Lives
from musebot.protocols.runs.run_files import RESULTS_FILE, ROBOTS_FILE, read_run
from musebot.protocols.runs.simulation import (
    UnfinishedRun,
    check_agents,
    check_same_weights,
    simulate,
)
from musebot.protocols.storage import locked

BOTH = (Condition("wall_avoidance", "creative"), Condition("spot_finding", "random"))


def plan(robots=4, conditions=BOTH, **changes):
    settings = {"cohort_size": 2, "time_scale": 0.0005} | changes
    return Plan.of(Experiment(**settings), conditions, robots)


def contents(directory):
    """Returns all files of a finished run; the manifest also names the machine and the time."""
    paths = [path for path in Path(directory).iterdir() if path.name != MANIFEST]
    return {path.name: path.read_bytes() for path in paths}


@pytest.fixture
def run(in_process):
    """Simulates robots in this process, or by another executor."""

    def run(directory, the_plan, executor=None):
        return simulate(Path(directory), the_plan, executor or in_process(), quiet=True)

    return run


@pytest.fixture(scope="module")
def whole(in_process, tmp_path_factory):
    """The folder of a finished run of `plan()`, and what `simulate` returned."""
    directory = tmp_path_factory.mktemp("whole") / "run"
    return directory, simulate(directory, plan(), in_process(), quiet=True)


def keys(executor):
    return [job.key for job in executor.jobs]


def assert_same(one, other, conditions):
    for condition in conditions:
        assert str(one.robots(condition)) == str(other.robots(condition))  # NaN equals NaN
        np.testing.assert_array_equal(one.curves(condition), other.curves(condition))
        for when in ("before", "after"):
            networks = (part.results[condition].networks[when] for part in (one, other))
            np.testing.assert_equal(*networks)


def test_a_run_returns_what_its_files_hold_and_leaves_no_others(whole):
    directory, returned = whole
    read = read_run(directory)
    assert (returned.name, returned.experiment) == (read.name, read.experiment)
    assert (read.name, read.experiment) == ("run", plan().experiment)
    assert returned.conditions() == read.conditions() == sorted(BOTH)
    assert_same(returned, read, BOTH)
    assert ROBOTS_FILE in contents(directory) and not (directory / "checkpoints").exists()


def test_the_same_seed_leaves_the_same_bytes_in_any_processes_and_another_seed_does_not(
    run, whole, tmp_path, processes_that_have_imported
):
    run(tmp_path / "same", plan(), Local(2))
    run(tmp_path / "other", plan(seed=2))
    other = contents(tmp_path / "other")
    assert contents(tmp_path / "same") == contents(whole[0])
    assert any(other[name] != content for name, content in contents(whole[0]).items())


@pytest.mark.parametrize("part", [{"robots": 2}, {"conditions": BOTH[1:]}], ids=str)
def test_a_finished_run_can_be_enlarged_and_is_never_made_smaller(part, run, whole, tmp_path):
    small = run(tmp_path / "grown", plan(**part))
    assert_same(run(tmp_path / "alone", plan(conditions=BOTH[1:])), whole[1], BOTH[1:])
    run(tmp_path / "grown", plan())
    assert contents(tmp_path / "grown") == contents(whole[0])
    assert len(small.conditions()) == len(plan(**part).robots)
    again = run(tmp_path / "grown", plan(**part))
    assert [len(again.robots(condition)) for condition in BOTH] == [4, 4]
    assert contents(tmp_path / "grown") == contents(whole[0])


def test_conditions_that_the_command_does_not_name_wait_and_keep_what_they_have(
    run, whole, in_process, tmp_path, capsys
):
    with pytest.raises(Interrupted):
        run(tmp_path, plan(), first := in_process(most=1))
    begun = first.jobs[0].key.condition
    (other,) = {*BOTH} - {begun}
    simulate(tmp_path, plan(2, [other]), executor := in_process())
    said = capsys.readouterr().err
    assert f"the run plans more robots of {other}" in said
    assert f"the run still lacks robots of {begun}" in said
    assert {key.condition for key in keys(executor)} == {other}
    assert_same(read_run(tmp_path), whole[1], [other])
    assert len(list((tmp_path / "checkpoints").iterdir())) == 1
    run(tmp_path, plan(), last := in_process())
    assert [key.condition for key in keys(last)] == [begun]
    assert contents(tmp_path) == contents(whole[0])


def test_robots_that_another_command_adds_before_the_lock_stay(run, whole, tmp_path, monkeypatch):
    lock = simulation.locked

    def late(folder):
        monkeypatch.setattr(simulation, "locked", lock)
        run(folder, plan(conditions=BOTH[1:]))  # the other command
        return lock(folder)

    monkeypatch.setattr(simulation, "locked", late)
    run(tmp_path, plan(conditions=BOTH[:1]))
    assert contents(tmp_path) == contents(whole[0])


def test_a_run_whose_folder_was_moved_spares_the_run_that_took_its_place(
    run, tmp_path, monkeypatch
):
    ours, moved, finished = tmp_path / "ours", tmp_path / "moved", UnfinishedRun.finished

    def late(self, job):
        monkeypatch.setattr(UnfinishedRun, "finished", finished)
        ours.rename(moved)
        run(ours, plan(seed=2))
        finished(self, job)

    monkeypatch.setattr(UnfinishedRun, "finished", late)
    with pytest.raises(RunError, match=f"was moved or deleted .* lies in {moved}$"):
        run(ours, plan())
    assert read_run(ours).experiment.seed == 2


def test_a_finished_run_is_not_simulated_again_and_says_so(whole, tmp_path, capsys, monkeypatch):
    monkeypatch.setattr("musebot.protocols.runs.plan.machine_bytes", lambda: 10)
    monkeypatch.setattr(simulation, "check_device", pytest.fail)  # it needs neither
    shutil.copytree(whole[0], folder := tmp_path / "run")
    change_physics(folder)  # as little
    before = files_below(folder)
    simulate(folder, plan(), pytest.fail)
    assert files_below(folder) == before
    words = "all these robots (all durations times 0.0005; another folder starts another run), so"
    assert words in capsys.readouterr().err


@pytest.mark.parametrize("begun", [False, True])
def test_a_run_that_had_begun_names_both_machines(begun, run, tmp_path, monkeypatch, in_process):
    here, small = os.cpu_count(), plan(robots=2)
    with pytest.raises(Interrupted):
        run(tmp_path, small, in_process(most=begun))
    monkeypatch.setattr(os, "cpu_count", lambda: 1000)
    run(tmp_path, small)
    made_with = json.loads((tmp_path / MANIFEST).read_text())["made_with"]
    assert [made["cores"] for made in made_with] == [here, 1000][not begun :]


# What is refused


@pytest.mark.parametrize(
    ("damage", "seed", "words"),
    [
        ("results", 1, "damaged"),
        ("seed", 2, "holds an experiment with seed 1, not 2"),
        ("physics", 1, "was simulated in another physics"),
    ],
)
def test_nothing_is_changed_in_a_run_that_cannot_be_continued(
    damage, seed, words, run, tmp_path, in_process
):
    directory = tmp_path / "run"
    run(directory, plan(conditions=BOTH[:1]))
    with pytest.raises(Interrupted):
        run(directory, plan(), in_process(most=1))
    if damage == "results":
        (directory / RESULTS_FILE).write_bytes(b"damaged")
    if damage == "physics":
        change_physics(directory)
    before, executor = files_below(tmp_path), in_process()
    with pytest.raises(InputError, match=words):
        run(directory, plan(seed=seed), executor)
    assert files_below(tmp_path) == before and executor.jobs == []


def test_a_run_is_continued_with_its_settings_in_any_order(tmp_path):
    learner = Condition("spot_finding", recorded_name("q_learner"))
    words = ("rate=0.1", "discount=0.8")
    ours, other = (plan(2, [learner], settings=one) for one in (words, words[::-1]))
    write_manifest(tmp_path, ours)
    trust(learner.proposer)
    assert UnfinishedRun.read(tmp_path, other).plan == ours


def test_what_the_folder_or_the_machine_cannot_hold_is_refused_before_it_is_begun(
    run, tmp_path, monkeypatch
):
    with locked(tmp_path / "run"), pytest.raises(InputError, match="another musebot .*is running"):
        run(tmp_path / "run", plan(), pytest.fail)
    assert not files_below(tmp_path)
    monkeypatch.setattr("musebot.protocols.runs.plan.machine_bytes", lambda: 10**6)
    large = plan(1000, cohort_size=1000)
    with pytest.raises(InputError, match="would need about .* of memory; this machine has"):
        run(tmp_path / "new", large, pytest.fail)
    assert not (tmp_path / "new").exists()


def test_robots_with_other_weights_than_those_of_the_run_are_not_added(tmp_path):
    learner = Condition("spot_finding", recorded_name("q_learner"))
    held = Lives(*[np.empty(0)] * 3, {}, {"old": np.empty(0)})
    with pytest.raises(InputError, match="keeps other weights than the robots of the run.*: .*old"):
        check_agents(plan(4, [learner]), {learner: held})
    with pytest.raises(InputError, match="are kept without their networks"):
        check_agents(plan(4, [learner]), {learner: Lives(*[np.empty(0)] * 3, {}, {})})
    own = {"table": np.zeros((3, 4), np.float32)}
    check_same_weights(learner, own, {"table": np.ones((9, 4), np.float32)})
    for other in (np.zeros((3, 4)), np.zeros((3, 5), np.float32)):
        with pytest.raises(InputError, match="which another version simulated: table"):
            check_same_weights(learner, own, {"table": other})

    (tmp_path / "checkpoints").mkdir()
    unfinished = UnfinishedRun(tmp_path, plan(4, [learner]), {}, plan(4, [learner]).cohorts(), {})
    for size, key in enumerate(unfinished.plan.cohorts(), 1):
        weights = {"table": np.zeros((2, size))}
        lives = Cohort(unfinished.plan.experiment, key).lives()
        lives = dataclasses.replace(lives, before=weights, after=weights)
        save_lives(finished_file(tmp_path, key), lives, unfinished.plan.experiment, key)
    with pytest.raises(InputError, match="0001 keeps other weights than the robots of the run"):
        unfinished.begin()
