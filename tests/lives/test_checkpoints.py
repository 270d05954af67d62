"""A restored cohort continues bit-exactly, and a damaged file is never taken for a sound one."""

import dataclasses
import errno
import io
import os
import random

import numpy as np
import pytest

from musebot.protocols.errors import DamagedFileError
from musebot.protocols.lives.agent import network_shapes
from musebot.protocols.lives.checkpoints import (
    checkpoint_file,
    finished_file,
    read_lives,
    restored_cohort,
    save_checkpoint,
    save_lives,
    set_aside,
)
from musebot.protocols.lives.cohort import Cohort
from musebot.protocols.lives.conditions import CohortKey, Condition
from musebot.protocols.lives.experiment import Experiment
from musebot.protocols.lives.overrides import named_brain
from musebot.protocols.storage import load_arrays, save_arrays

KEY = CohortKey(Condition("wall_avoidance", "creative"), 1)
SHORT = Experiment(cohort_size=2, time_scale=0.004, body="kinematic")


@pytest.mark.parametrize("brain", ["paper", "steady"])
@pytest.mark.parametrize("proposer", ["fixed", "random", "creative"])
@pytest.mark.parametrize("task", ["wall_avoidance", "spot_finding"])
def test_a_restored_cohort_continues_bit_exactly(task, proposer, brain):
    scale = 0.007 if task == "wall_avoidance" else 0.003  # a minute, and a refill of the noise
    experiment = Experiment(cohort_size=3, time_scale=scale, brain=named_brain(brain))
    check_restored(experiment, CohortKey(Condition(task, proposer), 0))


@pytest.mark.parametrize("steps", [0, 7])
def test_held_noise_continues_bit_exactly(steps):
    brain = dataclasses.replace(named_brain("paper"), noise_steps=steps)
    experiment = Experiment(cohort_size=3, time_scale=0.01, brain=brain, body="kinematic")
    check_restored(experiment, KEY)


def check_restored(experiment, key):
    """Checks that a life of many cohorts, each restored from the one before, is the whole life."""
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
    save_checkpoint(checkpoint_file(tmp_path, KEY), cohort)
    restored, message = restored_cohort(checkpoint_file(tmp_path, KEY), SHORT, KEY)
    assert message == "" and restored.step == 77
    np.testing.assert_equal(restored.checkpoint(), cohort.checkpoint())
    _, notes = load_arrays(checkpoint_file(tmp_path, KEY))
    assert notes["cohort"] == str(KEY)


def test_a_cohort_without_a_checkpoint_is_newborn(tmp_path):
    cohort, message = restored_cohort(checkpoint_file(tmp_path, KEY), SHORT, KEY)
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
    path = checkpoint_file(tmp_path, KEY)
    save_checkpoint(path, cohort)
    spoil(path)
    restored, message = restored_cohort(path, SHORT, KEY)
    assert restored.step == 0
    np.testing.assert_equal(restored.checkpoint(), Cohort(SHORT, KEY).checkpoint())
    assert message.endswith(f"set aside, cohort {KEY} starts anew")
    assert not path.exists() and path.with_suffix(".damaged").exists()


@pytest.fixture(scope="module")
def lives():
    """What a finished cohort of the key leaves."""
    cohort = Cohort(SHORT, KEY)
    cohort.advance(cohort.steps)
    return cohort.lives()


def test_what_a_finished_cohort_leaves_survives_its_file(tmp_path, lives):
    path = finished_file(tmp_path, KEY)
    save_lives(path, lives, SHORT, KEY)
    read = read_lives(path, SHORT, KEY)
    np.testing.assert_equal(vars(read), vars(lives))
    assert (read.events.dtype, read.minutes.dtype) == (np.int32, np.int16)


def test_lives_of_an_agent_without_weights_have_no_networks(tmp_path, lives):
    key = CohortKey(Condition("wall_avoidance", "some.where:agent"), 0)
    save_lives(tmp_path / "file", dataclasses.replace(lives, before={}, after={}), SHORT, key)
    read = read_lives(tmp_path / "file", SHORT, key)
    assert (read.before, read.after) == ({}, {})


def test_a_missing_or_damaged_finished_cohort_is_not_read(tmp_path):
    path = finished_file(tmp_path, KEY)
    with pytest.raises(FileNotFoundError):
        read_lives(path, SHORT, KEY)
    path.parent.mkdir()
    path.write_bytes(b"nonsense")
    with pytest.raises(DamagedFileError, match=path.name):
        read_lives(path, SHORT, KEY)


# Files of others, and impossible values

OTHERS = [
    (dataclasses.replace(SHORT, seed=2), KEY, "is of an experiment with seed 2, not 1"),
    (
        dataclasses.replace(SHORT, learn_across_placement=True),
        KEY,
        "is of an experiment with learn_across_placement True, not False",
    ),
    (
        SHORT,
        dataclasses.replace(KEY, index=0),
        f"is of the cohort 'wall_avoidance-creative-0000', not {KEY}",
    ),
    (SHORT, CohortKey(Condition("wall_avoidance", "random"), 1), "is of the cohort"),
]


def other_lives(lives, key):
    names = network_shapes(SHORT, key.condition)
    before, after = ({n: nets[n] for n in names} for nets in (lives.before, lives.after))
    return dataclasses.replace(lives, before=before, after=after)


@pytest.mark.parametrize(("experiment", "key", "words"), OTHERS)
def test_a_finished_cohort_of_another_experiment_or_key_is_refused(
    tmp_path, lives, experiment, key, words
):
    path = finished_file(tmp_path, KEY)
    save_lives(path, other_lives(lives, key), experiment, key)
    with pytest.raises(DamagedFileError) as caught:
        read_lives(path, SHORT, KEY)
    # Robots without a creative memory lack its arrays, which are read first.
    missing = "memory.hidden_biases is missing" if key.condition != KEY.condition else words
    assert str(path) in str(caught.value) and missing in str(caught.value)


@pytest.mark.parametrize(("experiment", "key", "words"), OTHERS)
def test_a_checkpoint_of_another_experiment_or_key_is_set_aside(tmp_path, experiment, key, words):
    cohort = Cohort(experiment, key)
    cohort.advance(77)
    save_checkpoint(checkpoint_file(tmp_path, key), cohort)
    path = checkpoint_file(tmp_path, KEY)
    if key != KEY:
        checkpoint_file(tmp_path, key).rename(path)
    restored, message = restored_cohort(path, SHORT, KEY)
    assert restored.step == 0
    if key.condition == KEY.condition:
        assert words in message
    assert message.endswith(f"set aside, cohort {KEY} starts anew")
    assert path.with_suffix(".damaged").exists() and not path.exists()


def test_a_file_of_an_older_version_that_does_not_name_its_experiment_is_set_aside(tmp_path, lives):
    path = finished_file(tmp_path, KEY)
    save_lives(path, lives, SHORT, KEY)
    arrays, _ = load_arrays(path)
    save_arrays(path, arrays)
    with pytest.raises(DamagedFileError) as caught:
        read_lives(path, SHORT, KEY)
    assert str(caught.value) == f"{path} is of an older version and does not name its experiment"


@pytest.mark.parametrize("value", ["150", 1.5, True, None, -1, [77]])
def test_a_checkpoint_whose_step_is_no_number_of_steps_is_set_aside(tmp_path, value):
    cohort = Cohort(SHORT, KEY)
    cohort.advance(77)
    path = checkpoint_file(tmp_path, KEY)
    save_checkpoint(path, cohort)
    arrays, notes = load_arrays(path)
    save_arrays(path, arrays, **notes | {"step": value})
    restored, message = restored_cohort(path, SHORT, KEY)
    assert restored.step == 0
    assert "step must be a whole number in [0, " in message


@pytest.mark.parametrize("state", [None, 1, {}, {"bit_generator": "MT19937"}, "big", "other"])
def test_a_checkpoint_whose_random_stream_is_damaged_is_set_aside(tmp_path, state):
    cohort = Cohort(SHORT, KEY)
    cohort.advance(77)
    path = checkpoint_file(tmp_path, KEY)
    save_checkpoint(path, cohort)
    arrays, notes = load_arrays(path)
    if state == "big":
        state = notes["random"] | {"state": {"state": 2**200, "inc": 1}}
    if state == "other":
        state = notes["random"] | {"has_uint32": 0.5}
    save_arrays(path, arrays, **notes | {"random": state})
    restored, message = restored_cohort(path, SHORT, KEY)
    assert restored.step == 0
    assert "random stream is damaged" in message
    np.testing.assert_equal(restored.checkpoint(), Cohort(SHORT, KEY).checkpoint())


@pytest.mark.parametrize(
    ("name", "index", "value", "words"),
    [
        ("events", (1, 0), -5, "events, row 1, column 0: must lie in [0, "),
        ("events", (0, 2), 30_000, "events, row 0, column 2: must lie in [0, "),
        ("minutes", (0, 0), 601, "minutes, row 0, column 0: must lie in [0, "),
        ("minutes", (0, 0), 1, "row 0: its events and its minutes have different sums"),
        ("before.evaluation.hidden_biases", (1, 0), np.nan, "row 1: must be finite"),
        ("before.evaluation.hidden_biases", (1, 0), 3, "row 1: must be finite and within [-1, 1]"),
    ],
)
@pytest.mark.parametrize("kind", ["checkpoint", "finished"])
def test_impossible_values_are_refused_with_row_and_column(
    tmp_path, lives, kind, name, index, value, words
):
    if kind == "checkpoint":
        cohort = Cohort(SHORT, KEY)
        cohort.advance(77)
        path = checkpoint_file(tmp_path, KEY)
        save_checkpoint(path, cohort)
    else:
        path, name = finished_file(tmp_path, KEY), name.replace("before.", "before/")
        save_lives(path, lives, SHORT, KEY)
    arrays, notes = load_arrays(path)
    for counts in ("events", "minutes"):
        arrays[counts][:] = 0
    arrays[name][index] = value
    save_arrays(path, arrays, **notes)
    if kind == "checkpoint":
        restored, message = restored_cohort(path, SHORT, KEY)
        assert restored.step == 0
    else:
        with pytest.raises(DamagedFileError) as caught:
            read_lives(path, SHORT, KEY)
        message = str(caught.value)
    assert str(path) in message
    assert words in message


def test_one_number_of_a_valid_robot_that_is_not_finite_is_refused(tmp_path):
    cohort = Cohort(SHORT, KEY)
    cohort.advance(77)
    save_checkpoint(checkpoint_file(tmp_path, KEY), cohort)
    arrays, notes = load_arrays(checkpoint_file(tmp_path, KEY))
    name = next(n for n, a in arrays.items() if n.startswith("batch.") and a.ndim == 2)
    assert arrays[name].shape[1] > 1
    arrays[name][1, 0] = np.nan
    save_arrays(checkpoint_file(tmp_path, KEY), arrays, **notes)
    restored, message = restored_cohort(checkpoint_file(tmp_path, KEY), SHORT, KEY)
    assert restored.step == 0 and f"{name}, row 1: must be finite" in message


@pytest.mark.parametrize("dtype", [np.float32, np.float64, np.int64])
@pytest.mark.parametrize("kind", ["checkpoint", "finished"])
def test_events_of_another_dtype_are_refused(tmp_path, lives, kind, dtype):
    if kind == "checkpoint":
        path = checkpoint_file(tmp_path, KEY)
        save_checkpoint(path, Cohort(SHORT, KEY))
    else:
        path = finished_file(tmp_path, KEY)
        save_lives(path, lives, SHORT, KEY)
    arrays, notes = load_arrays(path)
    save_arrays(path, arrays | {"events": arrays["events"].astype(dtype)}, **notes)
    if kind == "checkpoint":
        assert "events must be I32" in restored_cohort(path, SHORT, KEY)[1]
    else:
        with pytest.raises(DamagedFileError, match="events must be I32"):
            read_lives(path, SHORT, KEY)


def test_a_pipe_in_place_of_a_checkpoint_is_set_aside_and_not_waited_for(tmp_path):
    path = checkpoint_file(tmp_path, KEY)
    path.parent.mkdir()
    os.mkfifo(path)
    restored, message = restored_cohort(path, SHORT, KEY)
    assert restored.step == 0
    assert f"{path} is not a regular file" in message


@pytest.mark.parametrize(("place", "name"), [(io, "open"), (os, "stat")])
def test_a_file_that_cannot_be_read_is_no_damage_and_stays(place, name, tmp_path, monkeypatch):
    advanced = Cohort(SHORT, KEY)
    advanced.advance(3)
    path = checkpoint_file(tmp_path, KEY)
    save_checkpoint(path, advanced)
    real = getattr(place, name)

    def fail(file, *args, **kwargs):
        if str(file) == str(path):
            raise OSError(errno.EIO, "Input/output error", str(path))
        return real(file, *args, **kwargs)

    with monkeypatch.context() as patch:
        patch.setattr(place, name, fail)
        with pytest.raises(OSError, match="Input/output error"):
            restored_cohort(path, SHORT, KEY)
    assert [*path.parent.iterdir()] == [path]


def test_a_file_that_is_set_aside_keeps_its_content(tmp_path):
    path = finished_file(tmp_path, KEY)
    path.parent.mkdir()
    path.write_bytes(b"nonsense")
    message = set_aside(path, KEY, DamagedFileError(f"{path} is damaged"))
    assert message == f"{path} is damaged; set aside, cohort {KEY} starts anew"
    assert path.with_suffix(".damaged").read_bytes() == b"nonsense"
    assert not path.exists()
