"""Files are whole or not there, and what is damaged is never taken for sound."""

import os
import random
import sys
from pathlib import Path

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as npst
from safetensors.numpy import save

from musebot.controller import Neurocontroller, Parameters
from musebot.protocols.errors import DamagedFileError
from musebot.protocols.storage import load_arrays, remove_drafts, save_arrays, write_atomically

quick = settings(deadline=None, max_examples=50)

ARRAYS = {
    "weights": np.linspace(-1, 1, 12, dtype=np.float32).reshape(3, 4),
    "age": np.array(500),
    "valid": np.array([True, False]),
    "nothing": np.zeros((0, 3)),
}
NOTES = {"step": 7, "random": {"state": 2**127 + 1}}


def files(folder):
    """Everything in a folder, hidden or not."""
    return {path.name: path.read_bytes() for path in folder.iterdir()}


def equal(first, second):
    return first.keys() == second.keys() and all(
        first[k].dtype == second[k].dtype
        and first[k].shape == second[k].shape
        and first[k].tobytes() == second[k].tobytes()
        for k in first
    )


# Arrays and notes

arrays = st.dictionaries(
    st.text(max_size=8).filter(lambda name: name != "__metadata__"),
    npst.arrays(
        st.sampled_from([np.float32, np.float64, np.int16, np.int32, np.int64, np.uint8, bool]),
        npst.array_shapes(min_dims=0, max_dims=3, min_side=0, max_side=4),
    ),
    max_size=4,
)
json = st.recursive(
    st.none()
    | st.booleans()
    | st.integers(-(2**200), 2**200)
    | st.floats(allow_nan=False)
    | st.text(max_size=8),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=4), inner),
    max_leaves=5,
)


@quick
@given(arrays, st.dictionaries(st.sampled_from(["step", "random", "o"]), json))
def test_arrays_and_notes_come_back_as_they_were(tmp_path_factory, arrays, notes):
    path = tmp_path_factory.mktemp("storage") / "file.safetensors"
    save_arrays(path, arrays, **notes)
    read, read_notes = load_arrays(path)
    assert equal(read, arrays)
    assert read_notes == notes


def test_arrays_that_are_views_come_back_as_they_look(tmp_path):
    whole = np.arange(24.0).reshape(2, 3, 4)
    views = {"t": whole.T, "every other": whole[:, ::2], "back": whole[::-1], "f": whole.copy("F")}
    save_arrays(tmp_path / "file", views)
    read, _ = load_arrays(tmp_path / "file")
    for name, view in views.items():
        np.testing.assert_array_equal(read[name], view)


def test_equal_content_makes_equal_files(tmp_path):
    save_arrays(tmp_path / "one", ARRAYS, **NOTES)
    save_arrays(tmp_path / "two", dict(reversed(ARRAYS.items())), **dict(reversed(NOTES.items())))
    assert (tmp_path / "one").read_bytes() == (tmp_path / "two").read_bytes()


@pytest.mark.parametrize("proposer", ["fixed", "creative"])
def test_the_state_of_a_brain_survives_the_file(tmp_path, proposer):
    brain, other = (Neurocontroller(Parameters(), proposer, 3, 5, seed) for seed in (1, 2))
    brain.act(torch.rand(3, 5), explore=True)
    path = tmp_path / "brain"
    save_arrays(path, {name: tensor.numpy() for name, tensor in brain.state().items()})
    arrays, _ = load_arrays(path)
    other.load_state({name: torch.from_numpy(array) for name, array in arrays.items()})
    state = torch.rand(3, 5)
    assert torch.equal(brain.act(state, explore=True), other.act(state, explore=True))


# Damage


@pytest.fixture
def sound(tmp_path):
    path = tmp_path / "brains.safetensors"
    save_arrays(path, ARRAYS, **NOTES)
    return path


def assert_damaged(path):
    with pytest.raises(DamagedFileError) as caught:
        load_arrays(path)
    assert str(path) in str(caught.value)


def test_a_file_truncated_anywhere_is_damaged(sound):
    whole = sound.read_bytes()
    for length in range(len(whole)):
        sound.write_bytes(whole[:length])
        assert_damaged(sound)
    sound.write_bytes(whole)
    assert equal(load_arrays(sound)[0], ARRAYS)


def test_a_file_with_a_flipped_bit_in_any_byte_is_damaged(sound):
    whole = sound.read_bytes()
    bits = random.Random(0)
    for index in range(len(whole)):
        flipped = bytearray(whole)
        flipped[index] ^= 1 << bits.randrange(8)
        sound.write_bytes(flipped)
        assert_damaged(sound)


def test_a_file_with_something_after_its_end_is_damaged(sound):
    sound.write_bytes(sound.read_bytes() + b"\0")
    assert_damaged(sound)


@pytest.mark.parametrize("content", [b"", b"robots", b"\0" * 100, b"PK\x03\x04", b"\xff" * 64])
def test_a_file_of_another_kind_is_damaged(tmp_path, content):
    path = tmp_path / "file"
    path.write_bytes(content)
    assert_damaged(path)


def test_a_file_of_safetensors_that_is_not_ours_is_damaged(tmp_path):
    ours = [
        "",
        "[]",
        "{}",
        '{"notes": "{}"}',
        *(f'{{"notes": {n}, "digest": "0"}}' for n in ("1", "[]")),
    ]
    foreign = [None, {}, {"notes": "{}", "digest": "0"}, *({"musebot": text} for text in ours)]
    for index, metadata in enumerate(foreign):
        path = tmp_path / str(index)
        path.write_bytes(save({"weights": ARRAYS["weights"]}, metadata=metadata))
        assert_damaged(path)


def test_a_missing_file_is_missing_and_not_damaged(tmp_path):
    with pytest.raises(FileNotFoundError, match="nowhere"):
        load_arrays(tmp_path / "nowhere")


# Writing


def test_what_is_written_is_read_and_nothing_else_is_left(tmp_path):
    path = tmp_path / "new" / "folder" / "file"
    write_atomically(path, b"first")
    write_atomically(path, b"second")
    assert files(path.parent) == {"file": b"second"}


def no_space(*_):
    raise OSError(28, "No space left on device")


@pytest.mark.parametrize("broken", ["os.fsync", "pathlib.Path.replace"])
@pytest.mark.parametrize("before", [{}, {"file": b"old"}])
def test_a_failed_write_leaves_the_old_file_and_no_draft(tmp_path, monkeypatch, broken, before):
    for name, content in before.items():
        (tmp_path / name).write_bytes(content)
    monkeypatch.setattr(broken, no_space)
    with pytest.raises(OSError, match="No space left"):
        write_atomically(tmp_path / "file", b"new")
    assert files(tmp_path) == before


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="needs Linux's /dev/full")
def test_a_full_disk_leaves_the_old_file_and_no_draft(tmp_path):
    (tmp_path / "file").write_bytes(b"old")
    (tmp_path / f".file.{os.getpid()}.draft").symlink_to("/dev/full")  # where the draft goes
    with pytest.raises(OSError, match="No space left"):
        write_atomically(tmp_path / "file", b"new")
    assert files(tmp_path) == {"file": b"old"}


def test_the_old_file_stands_until_the_new_one_is_whole_on_disk(tmp_path, monkeypatch):
    path = tmp_path / "file"
    path.write_bytes(b"old")
    seen, fsync = [], os.fsync

    def look(descriptor):
        fsync(descriptor)
        seen.append(path.read_bytes())
        drafts = [p for p in tmp_path.iterdir() if p != path]
        seen.extend(draft.read_bytes() for draft in drafts)

    monkeypatch.setattr(os, "fsync", look)
    write_atomically(path, b"new")
    # The draft is whole on disk before it takes the old one's place, and then the folder is.
    assert seen == [b"old", b"new", b"new"]
    assert files(tmp_path) == {"file": b"new"}


def test_drafts_of_killed_writers_are_removed_and_nothing_else(tmp_path):
    kept = {"file": b"1", ".hidden": b"2", ".file.12.draft.txt": b"3"}
    for name, content in (kept | {".file.12.draft": b"4"}).items():
        (tmp_path / name).write_bytes(content)
    remove_drafts(tmp_path)
    assert files(tmp_path) == kept


def test_a_failed_save_of_arrays_leaves_the_old_ones(sound, monkeypatch):
    monkeypatch.setattr(os, "fsync", no_space)
    with pytest.raises(OSError, match="No space left"):
        save_arrays(sound, {"weights": np.zeros(3)})
    assert equal(load_arrays(sound)[0], ARRAYS)
    assert list(files(sound.parent)) == [sound.name]


def test_nothing_is_pickled(tmp_path):
    with pytest.raises(Exception, match="(?i)object"):
        save_arrays(tmp_path / "file", {"what": np.array([sys], dtype=object)})
    assert files(tmp_path) == {}
