"""A checkpoint survives its file, and a damaged file is never taken for a sound one."""

import dataclasses
import errno
import io
import os

import numpy as np
import pytest

from musebot.controller import Parameters
from musebot.protocols.errors import DamagedFileError
from musebot.protocols.runs.checkpoints import (
    checkpoint_file,
    finished_file,
    read_lives,
    restored_cohort,
    save_checkpoint,
    save_lives,
)
from musebot.protocols.runs.cohort import Cohort
from musebot.protocols.runs.conditions import CohortKey, Condition
from musebot.protocols.runs.experiment import Experiment
from musebot.protocols.storage import load_arrays, save_arrays

KEY = CohortKey(Condition("wall_avoidance", "creative"), 1)
SHORT = Experiment(cohort_size=2, time_scale=0.004, body="kinematic")


@pytest.fixture(scope="module")
def young():
    """A cohort of the key at step 77."""
    cohort = Cohort(SHORT, KEY)
    cohort.advance(77)
    return cohort


@pytest.fixture(scope="module")
def lives():
    """What a finished cohort of the key leaves."""
    cohort = Cohort(SHORT, KEY)
    cohort.advance(cohort.steps)
    return cohort.lives()


def test_a_checkpoint_survives_its_file_and_without_one_a_cohort_is_newborn(tmp_path, young):
    path = checkpoint_file(tmp_path, KEY)
    newborn, message = restored_cohort(path, SHORT, KEY)
    assert (newborn.step, message) == (0, "")
    save_checkpoint(path, young)
    restored, message = restored_cohort(path, SHORT, KEY)
    assert (restored.step, message) == (77, "")
    np.testing.assert_equal(restored.checkpoint(), young.checkpoint())


def test_what_a_finished_cohort_leaves_survives_its_file(tmp_path, lives):
    path = finished_file(tmp_path, KEY)
    with pytest.raises(FileNotFoundError):  # missing, not damaged
        read_lives(path, SHORT, KEY)
    save_lives(path, lives, SHORT, KEY)
    np.testing.assert_equal(vars(read_lives(path, SHORT, KEY)), vars(lives))
    agent = CohortKey(Condition("wall_avoidance", "some.where:agent"), 0)
    bare = dataclasses.replace(lives, before={}, after={})  # of an agent without weights
    save_lives(path, bare, SHORT, agent)
    np.testing.assert_equal(vars(read_lives(path, SHORT, agent)), vars(bare))


def test_fixed_noisy_connections_survive_the_file_of_a_finished_cohort(tmp_path):
    experiment = dataclasses.replace(SHORT, brain=Parameters(noisy_connections="fixed"))
    lives, path = Cohort(experiment, KEY).lives(), finished_file(tmp_path, KEY)
    save_lives(path, lives, experiment, KEY)
    np.testing.assert_equal(vars(read_lives(path, experiment, KEY)), vars(lives))
    assert lives.after["noise.fixed"].shape == (2, 9)


# Files of others, or impossible with a digest that fits; tests/hostile changes every byte


def forged(path, name=None, array=None, **notes):
    """Changes an array, or removes it, and notes of a file; their digest is written anew."""
    held, said = load_arrays(path)
    if name:
        name = name if name in held else name.replace("/", ".")
        del held[name]
        held |= {} if array is None else {name: array}
    save_arrays(path, held, **{**said, **notes})


BIASES, EVENTS = "before/evaluation.hidden_biases", np.zeros((2, 3), np.int64)
BOTH = [
    ({"cohort": "other"}, f"with cohort other, not {KEY}"),
    ({"seed": 2}, "with seed 2, not 1"),
    ({"learn_across_placement": None}, "with learn_across_placement None, not False"),
    ({"name": "events"}, "events must be"),
    ({"name": "events", "array": EVENTS}, "events must be"),
    ({"name": BIASES, "array": np.zeros((2, 1), np.float32)}, "hidden_biases must be"),
]


def test_a_file_of_others_is_refused(tmp_path, young, lives):
    path = finished_file(tmp_path, KEY)
    for changes, words in BOTH:
        save_lives(path, lives, SHORT, KEY)
        forged(path, **changes)
        with pytest.raises(DamagedFileError, match=words) as caught:
            read_lives(path, SHORT, KEY)
        assert str(path) in str(caught.value) and "\n" not in str(caught.value)
        assert words in set_aside(tmp_path, young, **changes)


def set_aside(folder, young, **changes):
    """Forges a checkpoint, which must be set aside; returns the message."""
    path = checkpoint_file(folder, KEY)
    save_checkpoint(path, young)
    forged(path, **changes)
    content = path.read_bytes()
    restored, message = restored_cohort(path, SHORT, KEY)
    np.testing.assert_equal(restored.checkpoint(), Cohort(SHORT, KEY).checkpoint())
    assert message.startswith(str(path)) and "\n" not in message
    assert message.endswith(f"set aside, cohort {KEY} starts anew")
    assert not path.exists() and path.with_suffix(".damaged").read_bytes() == content
    return message


def test_a_checkpoint_with_an_impossible_step_or_random_stream_is_set_aside(tmp_path, young):
    for step in ("150", 1.5, True, None, -1, 10**9, [77]):
        assert "step must be a whole number in [0, " in set_aside(tmp_path, young, step=step)
    sound = young.checkpoint()[1]["random"]
    changes = {"bit_generator": "MT19937"}, {"state": {"state": 2**200, "inc": 1}}
    for state in (None, 1, {}, *(sound | own for own in (*changes, {"has_uint32": 0.5}))):
        assert "is damaged" in set_aside(tmp_path, young, random=state)


def test_an_agent_that_refuses_its_state_starts_anew(tmp_path, young, monkeypatch):
    def refuse(state):
        raise RuntimeError("a state of another agent")

    monkeypatch.setattr(type(young.agent), "load_state", lambda agent, state: refuse(state))
    assert "its agent does not continue" in set_aside(tmp_path, young)


def test_a_finished_cohort_with_impossible_numbers_is_refused(tmp_path, lives):
    path = finished_file(tmp_path, KEY)
    weights = next(iter(lives.after))
    valid = np.array([True, False])
    broken = np.full_like(lives.after[weights], np.nan)
    changes = {
        "events must be numbers": {"events": lives.events - np.int32(1000)},
        "minutes must be numbers": {"minutes": lives.minutes + np.int16(601)},
        "have different sums": {"events": 0 * lives.events, "minutes": 0 * lives.minutes + 1},
        "must be finite": {"after": lives.after | {weights: broken}},
    }
    for words, change in changes.items():
        save_lives(path, dataclasses.replace(lives, **change), SHORT, KEY)
        with pytest.raises(DamagedFileError, match=words):
            read_lives(path, SHORT, KEY)
    broken[0] = lives.after[weights][0]  # the other robot is not valid
    after = lives.after | {weights: broken}
    save_lives(path, dataclasses.replace(lives, valid=valid, after=after), SHORT, KEY)
    assert read_lives(path, SHORT, KEY).valid.tolist() == [True, False]


def test_a_file_that_cannot_be_read_is_no_damage_and_stays(tmp_path, monkeypatch, young):
    path = checkpoint_file(tmp_path, KEY)
    save_checkpoint(path, young)
    for place, name in ((io, "open"), (os, "stat")):
        real = getattr(place, name)

        def fail(file, *args, real=real, **kwargs):
            if str(file) == str(path):
                raise OSError(errno.EIO, "Input/output error", str(path))
            return real(file, *args, **kwargs)

        with monkeypatch.context() as patch, pytest.raises(OSError, match="Input/output error"):
            patch.setattr(place, name, fail)
            restored_cohort(path, SHORT, KEY)
    assert [*path.parent.iterdir()] == [path]
