"""A restored cohort continues bit-exactly, and a damaged file is never taken for a sound one."""

import dataclasses
import errno
import io
import os
import random

import numpy as np
import pytest

from musebot.protocols.errors import DamagedFileError
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
    body = "mujoco" if proposer == "creative" else "kinematic"
    experiment = Experiment(cohort_size=3, time_scale=scale, brain=named_brain(brain), body=body)
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


# Files that are damaged, of others, or impossible; tests/hostile changes every byte


@pytest.fixture(scope="module")
def young():
    """The arrays and notes of the key's checkpoint at step 77, as its file holds them."""
    cohort = Cohort(SHORT, KEY)
    cohort.advance(77)
    return cohort


@pytest.fixture
def refused(tmp_path, young, lives):
    """Forges the file of a checkpoint or of a finished cohort; returns why it is refused."""

    def refused(kind, change, experiment=SHORT, key=KEY):
        if kind == "checkpoint":
            path = checkpoint_file(tmp_path, KEY)
            own = young
            if (experiment, key) != (SHORT, KEY):
                own = Cohort(experiment, key)
                own.advance(77)
            save_checkpoint(path, own)
        else:
            path = finished_file(tmp_path, KEY)
            save_lives(path, lives, experiment, key)
        change(path)
        if kind == "finished":
            with pytest.raises(DamagedFileError) as caught:
                read_lives(path, SHORT, KEY)
            message = str(caught.value)
        else:
            restored, message = restored_cohort(path, SHORT, KEY)
            np.testing.assert_equal(restored.checkpoint(), Cohort(SHORT, KEY).checkpoint())
            assert message.endswith(f"set aside, cohort {KEY} starts anew")
            assert not path.exists() and os.path.lexists(path.with_suffix(".damaged"))
        assert str(path) in message and "\n" not in message
        return message

    return refused


def forge(arrays=None, notes=None):
    """Returns a change of arrays, given as functions by name, and of notes, with a new digest."""

    def change(path):
        held, said = load_arrays(path)
        for name, how in (arrays or {}).items():
            name = name if name in held else name.replace("before/", "before.")
            held[name] = how(held[name])
            if held[name] is None:
                del held[name]
        save_arrays(path, held, **{**said, **(notes or {})})

    return change


def at(index, value):
    def change(array):
        array = array.copy()
        array[index] = value
        return array

    return change


def pipe(path):
    path.unlink()
    os.mkfifo(path)


BIASES = "before/evaluation.hidden_biases"
BOTH = [
    (lambda path: path.write_bytes(path.read_bytes()[:-1]), "is damaged"),
    (pipe, "is not a regular file"),
    (forge({"events": lambda x: None}), "events is missing"),
    (forge({"events": lambda x: x.astype(np.int64)}), "events must be I32"),
    (forge({"minutes": lambda x: x[:1]}), "minutes must be I16 of shape"),
    (forge({"events": at((1, 0), -5)}), "events, row 1, column 0: must lie in [0, "),
    (forge({"minutes": at((0, 0), 601)}), "minutes, row 0, column 0: must lie in [0, "),
    (forge({BIASES: at((1, 0), np.nan)}), "row 1: must be finite"),
    (forge(notes={"cohort": "other"}), f"with cohort other, not {KEY}"),
    (forge(notes={"seed": None}), "with seed None, not 1"),
]


@pytest.mark.parametrize("kind", ["checkpoint", "finished"])
@pytest.mark.parametrize(("change", "words"), BOTH)
def test_a_damaged_or_impossible_file_is_refused(refused, kind, change, words):
    assert words in refused(kind, change)


@pytest.mark.parametrize("kind", ["checkpoint", "finished"])
@pytest.mark.parametrize(
    ("experiment", "key", "words"),
    [
        (dataclasses.replace(SHORT, seed=2), KEY, "with seed 2, not 1"),
        (dataclasses.replace(SHORT, learn_across_placement=True), KEY, "learn_across_placement"),
        (SHORT, dataclasses.replace(KEY, index=0), f"-creative-0000, not {KEY}"),
    ],
)
def test_a_file_of_another_experiment_or_cohort_is_refused(refused, kind, experiment, key, words):
    assert words in refused(kind, lambda path: None, experiment, key)


def test_a_checkpoint_of_another_condition_is_set_aside(refused):
    key = CohortKey(Condition("wall_avoidance", "random"), 1)
    refused("checkpoint", lambda path: None, key=key)


@pytest.mark.parametrize("value", ["150", 1.5, True, None, -1, 10**9, [77]])
def test_a_checkpoint_whose_step_is_no_number_of_steps_is_set_aside(refused, value):
    message = refused("checkpoint", forge(notes={"step": value}))
    assert "step must be a whole number in [0, " in message


@pytest.mark.parametrize(
    "state", [None, 1, {}, {"bit_generator": "MT19937"}, {"state": {"state": 2**200, "inc": 1}},
              {"has_uint32": 0.5}],
)  # fmt: skip
def test_a_checkpoint_whose_random_stream_is_damaged_is_set_aside(refused, young, state):
    if isinstance(state, dict) and state:
        state = young.checkpoint()[1]["random"] | state
    message = refused("checkpoint", forge(notes={"random": state}))
    assert "random stream is damaged" in message


def test_one_number_of_a_valid_robot_that_is_not_finite_is_refused(refused, young):
    arrays, _ = young.checkpoint()
    name = next(n for n, a in arrays.items() if n.startswith("batch.") and a.shape[1:] > (1,))
    assert "row 1: must be finite" in refused("checkpoint", forge({name: at((1, 0), np.nan)}))


def test_a_missing_finished_cohort_is_missing_and_not_damaged(tmp_path):
    with pytest.raises(FileNotFoundError):
        read_lives(finished_file(tmp_path, KEY), SHORT, KEY)


@pytest.mark.parametrize(("place", "name"), [(io, "open"), (os, "stat")])
def test_a_file_that_cannot_be_read_is_no_damage_and_stays(place, name, tmp_path, monkeypatch):
    path = checkpoint_file(tmp_path, KEY)
    save_checkpoint(path, Cohort(SHORT, KEY))
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
