"""Brains stored at nine times of their training, and their evaluation with frozen weights."""

import dataclasses
import shutil

import numpy as np
import pytest
import torch

from musebot.controller import BRAINS
from musebot.protocols.errors import InputError, RunError
from musebot.protocols.experiment.conditions import CohortKey, Condition
from musebot.protocols.experiment.experiment import Experiment
from musebot.protocols.simulation.cohort import Cohort
from musebot.protocols.storage import load_arrays, save_arrays
from musebot.protocols.studies.jobs import MinuteTick
from musebot.protocols.studies.learning_progress import frozen_brains
from musebot.protocols.studies.learning_progress.frozen_brains import (
    TIMES,
    FrozenTest,
    StoredLifeJob,
)

STEADY = BRAINS["steady"]
SHORT = Experiment(cohort_size=3, time_scale=0.005, body="kinematic", brain=STEADY)
KEY = CohortKey(Condition("spot_finding", "creative"), 0)
STEPS = 180 + 720  # control steps to the end of training


def run(job, reports=None, stop=lambda: False):
    return job.run(stop, lambda *report: None if reports is None else reports.append(report))


@pytest.fixture(scope="module")
def job(tmp_path_factory):
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    job, reports = StoredLifeJob(tmp_path_factory.mktemp("lives"), "steady", SHORT), []
    assert not job.done()
    assert run(job, reports) and job.done()
    assert reports[-1] == (job.cost, "") == (3 * STEPS * 0.1, "")
    assert (np.diff([cost for cost, _ in reports]) >= 0).all()
    yield job
    torch.set_num_threads(threads)


@pytest.fixture(scope="module")
def progress(job):
    return job.progress()


@pytest.fixture
def copy(job, tmp_path):
    """The same life in a folder of its own."""
    shutil.copy(job.path, tmp_path)
    return StoredLifeJob(tmp_path, "steady", SHORT)


def altered(job, arrays=(), notes=()):
    """Writes a life's file with other arrays or notes."""
    own, own_notes = load_arrays(job.path)
    save_arrays(job.path, own | dict(arrays), **(own_notes | dict(notes)))


def test_progress_begins_with_the_newborn_and_ends_with_the_trained_brains(progress):
    cohort = Cohort(SHORT, KEY)
    cohort.advance(10**9)
    lives = cohort.lives()
    assert len(progress.hours) == TIMES
    assert (progress.hours[0], progress.hours[-1]) == (0, pytest.approx(4 * 0.005))
    for name, networks in progress.networks.items():
        np.testing.assert_array_equal(networks[0], lives.before[name])
        np.testing.assert_array_equal(networks[-1], lives.after[name])
        assert not np.array_equal(networks[TIMES // 2], networks[-1])


def test_a_life_stopped_at_any_time_continues_to_the_same_bytes(job, tmp_path):
    other = StoredLifeJob(tmp_path, "steady", SHORT)
    for asked in (0, 1, 2, 1):  # after 1, 3, 6 and 8 of the nine times
        count = iter(range(10**9))
        assert run(other, stop=lambda count=count, asked=asked: next(count) == asked) is False
        assert not other.done()
        with pytest.raises(InputError, match="lacks networks of later times"):
            other.progress()
    assert run(other)
    assert other.path.read_bytes() == job.path.read_bytes()
    assert [path.name for path in tmp_path.iterdir()] == ["brains-steady.safetensors"]


def test_a_file_of_other_robots_is_refused(copy):
    whole = copy.path.read_bytes()
    arrays, _ = load_arrays(copy.path)
    biases = arrays["known.memory.output_biases"]
    for changed in (
        {"notes": {"step": 333}},
        {"notes": {"random": []}},
        {"arrays": {"known.memory.output_biases": biases[:-1]}},
        {"arrays": {"known.memory.output_biases": biases[:, :-1]}},
        {"arrays": {"known.memory.output_biases": np.float32(0)}},
    ):
        copy.path.write_bytes(whole)
        altered(copy, **changed)
        with pytest.raises(InputError, match="brains-steady.safetensors is of other robots"):
            copy.restored()
    for lost in ("known.memory.output_biases", "batch.valid"):
        fewer = {name: array for name, array in arrays.items() if name != lost}
        copy.path.write_bytes(whole)
        save_arrays(copy.path, fewer, **load_arrays(copy.path)[1])
        with pytest.raises(InputError, match="brains-steady.safetensors is of other robots"):
            copy.restored()
    copy.path.write_bytes(b"not ours")
    with pytest.raises(InputError, match="brains-steady.safetensors is damaged"):
        copy.restored()


def test_a_file_of_another_experiment_is_refused_and_one_that_names_none_is_read(copy):
    other = StoredLifeJob(copy.out, "steady", dataclasses.replace(SHORT, seed=2))
    with pytest.raises(InputError, match="is of other robots .*an experiment with seed 1, not 2"):
        other.restored()
    arrays, notes = load_arrays(copy.path)
    del notes["experiment"]  # as an earlier version
    save_arrays(copy.path, arrays, **notes)
    assert copy.done()


def test_weights_of_a_valid_robot_that_are_not_finite_are_refused(copy):
    biases = load_arrays(copy.path)[0]["known.memory.output_biases"]
    biases[3, 1, 0] = np.nan
    altered(copy, {"known.memory.output_biases": biases})
    with pytest.raises(InputError, match="memory.output_biases is not finite"):
        copy.restored()


def test_shares_that_are_none_are_refused(copy):
    test, progress = FrozenTest(copy, 0), copy.progress()
    for shares in (np.full((TIMES, 3), 1.5), np.zeros((TIMES, 2)), np.zeros(3)):
        save_arrays(test.path, {"shares": shares}, **test._notes(progress))
        with pytest.raises(InputError, match="test-steady-0.safetensors is damaged"):
            test.shares(progress)


def test_a_simulated_minute_counts_for_the_brains_of_a_group(copy, monkeypatch):
    monkeypatch.setattr(frozen_brains, "_TOGETHER", 10)  # 27 brains: three groups
    counted = []

    class Tick(MinuteTick):
        def __init__(self, job, robots, stop, report):
            counted.append(robots)
            super().__init__(job, robots, stop, report)

    monkeypatch.setattr(frozen_brains, "MinuteTick", Tick)
    assert FrozenTest(copy, 0).run(lambda: False, lambda done, message: None)
    assert counted == [9]


def test_frozen_brains_are_those_of_their_time_and_robot(progress):
    which = np.array([[0, TIMES - 1, 2], [2, 0, 1]])
    networks = progress.brains(which).controller.networks()
    for name, tensor in networks.items():
        for row, (when, robot) in enumerate(which.T):
            np.testing.assert_array_equal(tensor[row].numpy(), progress.networks[name][when, robot])


def test_robots_that_became_unstable_in_training_are_left_out(copy):
    valid = load_arrays(copy.path)[0]["batch.valid"]
    altered(copy, {"batch.valid": valid & (np.arange(3) != 1)})
    found = copy.progress()
    assert (found.robots, found.invalid) == (2, 1)
    assert {array.shape[:2] for array in found.networks.values()} == {(TIMES, 2)}
    altered(copy, {"batch.valid": np.zeros_like(valid)})
    with pytest.raises(RunError, match="steady: every simulation became unstable"):
        copy.progress()


# ---- Tests with frozen weights ----


def test_a_robot_that_becomes_unstable_in_a_test_has_no_share(progress):
    broken = {name: networks.copy() for name, networks in progress.networks.items()}
    broken["memory.output_biases"][-1, 1] = np.nan
    spoilt = dataclasses.replace(progress, networks=broken)
    shares = frozen_brains.evaluate(spoilt, 0)
    assert shares.shape == (TIMES, 3)
    assert np.isnan(shares).sum() == 1
    assert np.isnan(shares[-1, 1])


def test_a_test_is_kept_for_its_seed_and_repeated_for_other_brains(copy):
    tests = [FrozenTest(copy, seed) for seed in (0, 1)]
    reports = []
    for test in tests:
        assert not test.done()
        assert run(test, reports) and test.done()
    assert max(reports) == (pytest.approx(tests[0].cost), "")
    progress = copy.progress()
    for test in tests:
        expected = frozen_brains.evaluate(progress, test.seed)
        np.testing.assert_array_equal(test.shares(progress), expected)
    tests[0].path.write_bytes(tests[1].path.read_bytes())  # of another seed
    assert [test.done() for test in tests] == [False, True]
    altered(copy, {"known.memory.output_biases": 2 * progress.networks["memory.output_biases"]})
    assert [test.done() for test in tests] == [False, False]
    with pytest.raises(InputError, match="is another's: its brains"):
        tests[1].shares(copy.progress())
    tests[0].path.unlink()
    with pytest.raises(InputError, match="lacks test-steady-0.safetensors"):
        frozen_brains.evaluation(copy)


def test_a_test_stops_when_asked(copy):
    test = FrozenTest(copy, 0)
    assert run(test, stop=lambda: True) is False
    assert not test.path.exists()


# ---- Ideas ----


def test_the_smells_are_none_weaker_stronger_and_maximal():
    none, weak, strong, maximal = frozen_brains.smells(SHORT)[:, 0]
    assert none == 0 < weak < strong < maximal
    assert maximal == pytest.approx(10 / 11)


def test_many_ideas_have_next_to_no_regret_and_one_idea_has_more_and_no_spread(progress):
    def ideas(count):
        brain = dataclasses.replace(STEADY, ideas=count)
        experiment = dataclasses.replace(SHORT, brain=brain)
        return frozen_brains.ideas(dataclasses.replace(progress, experiment=experiment))

    (few_spread, few), (_, many) = ideas(1), ideas(2000)
    assert (few_spread == 0).all()
    assert (few >= 0).all() and (few <= 1).all()
    assert many.mean() < 0.03 < few.mean()
