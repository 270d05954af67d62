"""A restored cohort continues bit-exactly, and a damaged file is never taken for a sound one."""

import random

import numpy as np
import pytest

from musebot.protocols.errors import DamagedFileError
from musebot.protocols.experiment.conditions import CohortKey, Condition
from musebot.protocols.experiment.experiment import Experiment
from musebot.protocols.experiment.overrides import named_brain
from musebot.protocols.results.results import Lives
from musebot.protocols.simulation.checkpoints import (
    checkpoint_file,
    finished_file,
    read_lives,
    restored_cohort,
    save_checkpoint,
    save_lives,
    set_aside,
)
from musebot.protocols.simulation.cohort import Cohort
from musebot.protocols.storage import load_arrays, save_arrays

KEY = CohortKey(Condition("wall_avoidance", "creative"), 1)
SHORT = Experiment(cohort_size=2, time_scale=0.004, body="kinematic")


@pytest.mark.parametrize("brain", ["paper", "steady"])
@pytest.mark.parametrize("proposer", ["fixed", "random", "creative"])
@pytest.mark.parametrize("task", ["wall_avoidance", "spot_finding"])
def test_a_restored_cohort_continues_bit_exactly(task, proposer, brain):
    experiment = Experiment(cohort_size=3, time_scale=0.01, brain=named_brain(brain))
    key = CohortKey(Condition(task, proposer), 0)
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


def test_a_checkpoint_survives_its_file(tmp_path):
    cohort = Cohort(SHORT, KEY)
    cohort.advance(77)
    save_checkpoint(tmp_path, KEY, cohort)
    restored, message = restored_cohort(tmp_path, SHORT, KEY)
    assert message == "" and restored.step == 77
    np.testing.assert_equal(restored.checkpoint(), cohort.checkpoint())
    _, notes = load_arrays(checkpoint_file(tmp_path, KEY))
    assert notes["cohort"] == str(KEY)


def test_a_cohort_without_a_checkpoint_is_newborn(tmp_path):
    cohort, message = restored_cohort(tmp_path, SHORT, KEY)
    assert (cohort.step, message) == (0, "")


def spoil_bytes(path):
    path.write_bytes(path.read_bytes()[:-1])


def spoil_step(path):
    arrays, notes = load_arrays(path)
    save_arrays(path, arrays, **notes | {"step": 10**9})


def spoil_arrays(path):
    arrays, notes = load_arrays(path)
    save_arrays(path, {n: a for n, a in arrays.items() if n != "events"}, **notes)


def spoil_shape(path):
    arrays, notes = load_arrays(path)
    name = next(name for name in arrays if name.startswith("brain.evaluation"))
    save_arrays(path, arrays | {name: arrays[name][:1]}, **notes)


def spoil_notes(path):
    arrays, _ = load_arrays(path)
    save_arrays(path, arrays)


@pytest.mark.parametrize("spoil", [spoil_bytes, spoil_step, spoil_arrays, spoil_shape, spoil_notes])
def test_a_damaged_checkpoint_is_set_aside_and_the_cohort_is_newborn(spoil, tmp_path):
    cohort = Cohort(SHORT, KEY)
    cohort.advance(77)
    save_checkpoint(tmp_path, KEY, cohort)
    path = checkpoint_file(tmp_path, KEY)
    spoil(path)
    restored, message = restored_cohort(tmp_path, SHORT, KEY)
    assert restored.step == 0
    np.testing.assert_equal(restored.checkpoint(), Cohort(SHORT, KEY).checkpoint())
    assert message.endswith(f"set aside, cohort {KEY} starts anew")
    assert not path.exists() and path.with_suffix(".damaged").exists()


def test_what_a_finished_cohort_leaves_survives_its_file(tmp_path):
    draw = np.random.default_rng(0)
    networks = [
        {f"part.{n}": draw.random((2, 3), dtype=np.float32) for n in ("a", "b")} for _ in range(2)
    ]
    events, minutes = np.arange(6, dtype=np.int32).reshape(2, 3), np.ones((2, 5), dtype=np.int16)
    lives = Lives(events, minutes, np.array([True, False]), *networks)
    path = finished_file(tmp_path, KEY)
    save_lives(path, lives)
    read = read_lives(path)
    np.testing.assert_equal(vars(read), vars(lives))
    assert (read.events.dtype, read.minutes.dtype) == (np.int32, np.int16)


def test_lives_of_an_agent_without_weights_have_no_networks(tmp_path):
    lives = Lives(np.zeros((2, 3)), np.zeros((2, 5)), np.ones(2, dtype=bool), {}, {})
    save_lives(tmp_path / "file", lives)
    read = read_lives(tmp_path / "file")
    assert (read.before, read.after) == ({}, {})


def test_a_missing_or_damaged_finished_cohort_is_not_read(tmp_path):
    path = finished_file(tmp_path, KEY)
    with pytest.raises(FileNotFoundError):
        read_lives(path)
    path.parent.mkdir()
    path.write_bytes(b"nonsense")
    with pytest.raises(DamagedFileError, match=path.name):
        read_lives(path)


def test_a_file_that_is_set_aside_keeps_its_content(tmp_path):
    path = finished_file(tmp_path, KEY)
    path.parent.mkdir()
    path.write_bytes(b"nonsense")
    message = set_aside(path, KEY, DamagedFileError(f"{path} is damaged"))
    assert message == f"{path} is damaged; set aside, cohort {KEY} starts anew"
    assert path.with_suffix(".damaged").read_bytes() == b"nonsense"
    assert not path.exists()
