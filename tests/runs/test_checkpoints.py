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


# Files of others


def test_a_file_of_others_is_refused(tmp_path, young, lives):
    path = finished_file(tmp_path, KEY)
    others = {
        f"with cohort wall_avoidance-creative-0000, not {KEY}": (
            SHORT,
            CohortKey(KEY.condition, 0),
        ),
        "with seed 2, not 1": (dataclasses.replace(SHORT, seed=2), KEY),
    }
    for words, other in others.items():
        save_lives(path, lives, *other)
        with pytest.raises(DamagedFileError, match=words) as caught:
            read_lives(path, SHORT, KEY)
        assert str(path) in str(caught.value) and "\n" not in str(caught.value)
    save_checkpoint(path, young)
    with pytest.raises(DamagedFileError, match=f"^{path} holds no results"):
        read_lives(path, SHORT, KEY)
    checkpoint = checkpoint_file(tmp_path, KEY)
    save_lives(checkpoint, lives, SHORT, KEY)
    assert restored_cohort(checkpoint, SHORT, KEY)[0].step == 0


def set_aside(folder, young, **changes):
    """Changes a checkpoint's notes; it must be set aside; returns the message."""
    path = checkpoint_file(folder, KEY)
    save_checkpoint(path, young)
    arrays, notes = load_arrays(path)
    save_arrays(path, arrays, **notes | changes)
    content = path.read_bytes()
    restored, message = restored_cohort(path, SHORT, KEY)
    np.testing.assert_equal(restored.checkpoint(), Cohort(SHORT, KEY).checkpoint())
    assert message.startswith(str(path)) and "\n" not in message
    assert message.endswith(f"set aside, cohort {KEY} starts anew")
    assert not path.exists() and path.with_suffix(".damaged").read_bytes() == content
    return message


def test_a_checkpoint_with_another_random_stream_is_set_aside(tmp_path, young):
    sound = young.checkpoint()[1]["random"]
    for state in (None, {}, sound | {"bit_generator": "MT19937"}):
        assert "is damaged" in set_aside(tmp_path, young, random=state)


def test_an_agent_that_refuses_its_state_starts_anew(tmp_path, young, monkeypatch):
    def refuse(state):
        raise RuntimeError("a state of another agent")

    monkeypatch.setattr(type(young.agent), "load_state", lambda agent, state: refuse(state))
    assert "its agent does not continue" in set_aside(tmp_path, young)


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
