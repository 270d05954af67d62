"""Files are whole or absent, and a damaged file is never taken for a sound one."""

import os
import random
import secrets
import sys
from pathlib import Path

import numpy as np
import pytest
import safetensors
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as npst
from safetensors.numpy import save

from musebot.controller import Neurocontroller, Parameters
from musebot.protocols.errors import DamagedFileError, InputError
from musebot.protocols.storage import (
    MOST_BYTES,
    check_folder,
    check_own_folder,
    check_place,
    create_empty,
    digest,
    draft_name,
    is_draft,
    load_arrays,
    locked,
    read_json,
    read_whole,
    remove_drafts,
    remove_files,
    resolved_file,
    save_arrays,
    write_atomically,
    write_text,
)

quick = settings(deadline=None, max_examples=50)

ARRAYS = {
    "weights": np.linspace(-1, 1, 12, dtype=np.float32).reshape(3, 4),
    "age": np.array(500),
    "valid": np.array([True, False]),
    "nothing": np.zeros((0, 3)),
}
NOTES = {"step": 7, "random": {"state": 2**127 + 1}}


def files(folder):
    """Returns the content of every file in a folder, hidden or not."""
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
def test_arrays_and_notes_survive_the_file(tmp_path_factory, arrays, notes):
    path = tmp_path_factory.mktemp("storage") / "file.safetensors"
    save_arrays(path, arrays, **notes)
    read, read_notes = load_arrays(path)
    assert equal(read, arrays)
    assert read_notes == notes


def test_views_of_arrays_survive_the_file(tmp_path):
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


def test_a_file_that_is_truncated_anywhere_is_damaged(sound):
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


def test_a_file_with_a_byte_after_its_end_is_damaged(sound):
    sound.write_bytes(sound.read_bytes() + b"\0")
    assert_damaged(sound)


@pytest.mark.parametrize("content", [b"", b"robots", b"\0" * 100, b"PK\x03\x04", b"\xff" * 64])
def test_a_file_of_another_kind_is_damaged(tmp_path, content):
    path = tmp_path / "file"
    path.write_bytes(content)
    assert_damaged(path)


def test_a_file_of_safetensors_without_our_metadata_is_damaged(tmp_path):
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


def test_a_lack_of_memory_is_no_damage(sound, monkeypatch):
    def lacks(*_):
        raise MemoryError

    monkeypatch.setattr("musebot.protocols.storage.digest", lacks)
    with pytest.raises(MemoryError):
        load_arrays(sound)


def test_a_missing_file_is_missing_and_not_damaged(tmp_path):
    with pytest.raises(FileNotFoundError, match="nowhere"):
        load_arrays(tmp_path / "nowhere")


@pytest.mark.parametrize("kind", ["pipe", "folder", "device", "too large"])
def test_what_is_no_regular_file_or_too_large_is_refused_and_not_waited_for(tmp_path, kind):
    path = tmp_path / "file"
    if kind == "pipe":
        os.mkfifo(path)
    elif kind == "folder":
        path.mkdir()
    elif kind == "device":
        path.symlink_to("/dev/zero")
    else:
        with path.open("wb") as file:
            file.truncate(MOST_BYTES + 1)  # without a block on disk
    for read in (load_arrays, read_whole, read_json):
        with pytest.raises(DamagedFileError) as caught:
            read(path)
        wanted = f"{path} must have at most" if kind == "too large" else "is not a regular file"
        assert wanted in str(caught.value)


@pytest.mark.parametrize("text", ["[" * 100_000, '{"a":' * 100_000, "1" * 5000, "{", "\ud800"])
def test_json_that_is_too_deep_or_too_long_is_damaged(tmp_path, text):
    path = tmp_path / "file"
    path.write_bytes(text.encode(errors="surrogatepass"))
    with pytest.raises(DamagedFileError) as caught:
        read_json(path)
    assert str(path) in str(caught.value) and len(str(caught.value)) < 500
    metadata = [{"musebot": text.encode(errors="replace").decode()}]
    if text.isascii():
        metadata.append(
            {"musebot": '{"digest": "0", "notes": ' + repr(text).replace("'", '"') + "}"}
        )
    for one in metadata:
        path.write_bytes(save({"weights": ARRAYS["weights"]}, metadata=one))
        assert_damaged(path)


def test_notes_that_are_no_object_are_damaged(tmp_path):
    content = {"weights": ARRAYS["weights"]}
    text = '{"notes": "[1]", "digest": "' + digest(content, "[1]") + '"}'
    (tmp_path / "file").write_bytes(save(content, metadata={"musebot": text}))
    assert_damaged(tmp_path / "file")


def test_shapes_are_checked_before_arrays_are_read(sound, monkeypatch):
    def refuse(shapes):
        assert shapes["weights"] == ("F32", (3, 4)) and shapes["age"] == ("I64", ())
        raise ValueError("weights must be of another shape")

    monkeypatch.setattr("musebot.protocols.storage.digest", lambda *_: pytest.fail("it was read"))
    with pytest.raises(DamagedFileError, match="weights must be of another shape"):
        load_arrays(sound, refuse)


# Writing


def test_a_written_file_is_whole_and_leaves_no_other(tmp_path):
    path = tmp_path / "new" / "folder" / "file"
    write_atomically(path, b"first")
    write_atomically(path, b"second")
    assert files(path.parent) == {"file": b"second"}


def test_a_text_with_names_that_are_no_text_is_written_as_utf_8(tmp_path):
    write_text(tmp_path / "page.md", "runs/\udcff, 10 µs")
    assert (tmp_path / "page.md").read_text(encoding="utf-8") == "runs/\\udcff, 10 µs"


def no_space(*_, **__):
    raise OSError(28, "No space left on device")


@pytest.mark.parametrize("broken", ["os.fsync", "os.replace"])
@pytest.mark.parametrize("before", [{}, {"file": b"old"}])
def test_a_failed_write_leaves_the_old_file_and_no_draft(tmp_path, monkeypatch, broken, before):
    for name, content in before.items():
        (tmp_path / name).write_bytes(content)
    monkeypatch.setattr(broken, no_space)
    with pytest.raises(OSError, match="No space left") as caught:
        write_atomically(tmp_path / "file", b"new")
    assert str(caught.value) == f"[Errno 28] No space left on device: {str(tmp_path / 'file')!r}"
    assert files(tmp_path) == before


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="needs Linux's /dev/full")
def test_a_full_disk_leaves_the_old_file_and_no_draft(tmp_path, monkeypatch):
    (tmp_path / "file").write_bytes(b"old")
    with Path("/dev/full").open("wb") as full, monkeypatch.context() as patch:
        write = os.write
        patch.setattr(os, "write", lambda handle, content: write(full.fileno(), content))
        with pytest.raises(OSError, match="No space left"):
            write_atomically(tmp_path / "file", b"new")
    assert files(tmp_path) == {"file": b"old"}


def test_the_old_file_stays_until_the_new_one_is_whole_on_disk(tmp_path, monkeypatch):
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
    # The draft is on disk before it replaces the old file, and the folder after it did.
    assert seen == [b"old", b"new", b"new"]
    assert files(tmp_path) == {"file": b"new"}


def test_drafts_of_interrupted_writes_are_removed_and_nothing_else(tmp_path):
    ours = ".file.0123456789abcdef.musebot"
    kept = {"file": b"1", ".hidden": b"2", ".novel.2024.draft": b"3", f"{ours}.txt": b"5"}
    for name, content in (kept | {ours: b"4"}).items():
        (tmp_path / name).write_bytes(content)
    link = tmp_path / ".link.0123456789abcdef.musebot"
    link.symlink_to("file")
    assert [path.name for path in tmp_path.iterdir() if is_draft(path)] == [ours]
    remove_drafts(tmp_path)
    assert link.is_symlink()
    link.unlink()
    assert files(tmp_path) == kept


# Links


@pytest.fixture
def victim(tmp_path):
    """A folder of somebody else's that no command may touch."""
    folder = tmp_path / "victim"
    folder.mkdir()
    for name in ("file", ".novel.2024.draft", ".file.0123456789abcdef.musebot"):
        (folder / name).write_text("theirs")
    before = files(folder)
    yield folder
    assert files(folder) == before


def test_a_link_is_replaced_and_not_followed_by_a_write(tmp_path, victim):
    (tmp_path / "file").symlink_to(victim / "file")
    write_atomically(tmp_path / "file", b"ours")
    assert not (tmp_path / "file").is_symlink()
    assert (tmp_path / "file").read_bytes() == b"ours"


def test_a_draft_has_a_name_that_nobody_can_know_and_never_opens_what_is_there(
    tmp_path, victim, monkeypatch
):
    assert len({draft_name("file") for _ in range(100)}) == 100
    monkeypatch.setattr(secrets, "token_hex", lambda count: "0123456789abcdef")
    (tmp_path / ".file.0123456789abcdef.musebot").symlink_to(victim / "file")
    with pytest.raises(FileExistsError):
        write_atomically(tmp_path / "file", b"ours")


@pytest.mark.parametrize(
    "work",
    [
        lambda folder: write_atomically(folder / "file", b"ours"),
        lambda folder: create_empty(folder / "new"),
        lambda folder: remove_files(folder, lambda name: True),
        remove_drafts,
        check_own_folder,
        lambda folder: locked(folder).__enter__(),
    ],
)
def test_a_folder_that_is_a_link_is_refused(tmp_path, victim, work):
    folder = tmp_path / "figures"
    folder.symlink_to(victim)
    with pytest.raises(InputError) as caught:
        work(folder)
    assert str(caught.value) == f"{folder} is a link, which musebot does not follow"


def test_only_files_are_removed_neither_links_nor_folders(tmp_path, victim):
    folder = tmp_path / "checkpoints"
    folder.mkdir()
    (folder / "ours").write_text("")
    (folder / "link").symlink_to(victim / "file")
    (folder / "folder").mkdir()
    remove_files(folder, lambda name: True)
    assert {path.name for path in folder.iterdir()} == {"link", "folder"}
    remove_files(tmp_path / "nowhere", lambda name: True)


def test_a_user_may_name_a_file_in_a_folder_that_is_a_link(tmp_path):
    (tmp_path / "real").mkdir()
    (tmp_path / "link").symlink_to("real")
    path = resolved_file(tmp_path / "link" / "file")
    write_atomically(path, b"ours")
    assert files(tmp_path / "real") == {"file": b"ours"}


def test_a_failed_save_of_arrays_leaves_the_old_ones(sound, monkeypatch):
    monkeypatch.setattr(os, "fsync", no_space)
    with pytest.raises(OSError, match="No space left"):
        save_arrays(sound, {"weights": np.zeros(3)})
    assert equal(load_arrays(sound)[0], ARRAYS)
    assert list(files(sound.parent)) == [sound.name]


def test_objects_are_not_pickled(tmp_path):
    with pytest.raises(safetensors.SafetensorError, match='dtype "object"'):
        save_arrays(tmp_path / "file", {"what": np.array([sys], dtype=object)})
    assert files(tmp_path) == {}


# Digests


def test_a_digest_depends_on_names_types_shapes_values_and_notes():
    arrays = {"a": np.arange(4.0), "b": np.zeros((2, 2))}
    others = [
        {"c": np.arange(4.0), "b": np.zeros((2, 2))},
        {"a": np.arange(4.0, dtype=np.float32), "b": np.zeros((2, 2))},
        {"a": np.arange(4.0).reshape(2, 2), "b": np.zeros((2, 2))},
        {"a": np.arange(1.0, 5.0), "b": np.zeros((2, 2))},
    ]
    assert digest(arrays) == digest(dict(reversed(arrays.items())))
    assert len({digest(arrays), digest(arrays, "notes"), *map(digest, others)}) == 6
    assert len(bytes.fromhex(digest(arrays))) == 16


# Places and locks


def test_a_place_for_a_file_is_checked_before_the_work(tmp_path, monkeypatch):
    check_place(tmp_path / "file")
    with pytest.raises(InputError, match="is a folder"):
        check_place(tmp_path)
    with pytest.raises(InputError, match="there is no folder"):
        check_place(tmp_path / "new" / "file")
    (tmp_path / "link").symlink_to("file")
    with pytest.raises(InputError, match="is a link"):
        check_place(tmp_path / "link")
    os.mkfifo(tmp_path / "pipe")
    with pytest.raises(InputError, match="is no regular file"):
        check_place(tmp_path / "pipe")
    monkeypatch.setattr(os, "access", lambda path, mode: False)
    with pytest.raises(InputError, match="cannot be written"):
        check_place(tmp_path / "file")


def test_a_folder_can_be_made_or_is_refused(tmp_path, monkeypatch):
    check_folder(tmp_path / "new" / "folder")
    (tmp_path / "file").write_text("")
    with pytest.raises(InputError, match="is not a folder"):
        check_folder(tmp_path / "file" / "below")
    monkeypatch.setattr(os, "access", lambda path, mode: False)
    with pytest.raises(InputError, match="cannot be written"):
        check_folder(tmp_path / "new")


def test_a_locked_folder_is_refused_until_it_is_free(tmp_path):
    folder = tmp_path / "new" / "folder"
    with locked(folder):
        with pytest.raises(InputError) as caught, locked(folder):
            pass
        assert (
            str(caught.value) == f"another musebot (process {os.getpid()}) is running in {folder}"
        )
    with locked(folder):
        pass
    assert files(folder) == {}


@pytest.mark.parametrize("mask", [0o000, 0o027])
def test_new_files_have_the_permissions_that_the_user_asks_for(tmp_path, mask):
    before = os.umask(mask)
    try:
        create_empty(tmp_path / "empty")
        write_text(tmp_path / "text", "text")
    finally:
        os.umask(before)
    for name in ("empty", "text"):
        assert (tmp_path / name).stat().st_mode & 0o777 == 0o666 & ~mask


def test_a_file_in_the_place_of_a_folder_is_one_sentence(tmp_path):
    (tmp_path / "folder").write_text("a user's")
    with pytest.raises(InputError, match="is not a folder"):
        write_text(tmp_path / "folder" / "page.md", "x")
    assert (tmp_path / "folder").read_text() == "a user's"


@pytest.mark.skipif(not Path("/proc/self/fd").is_dir(), reason="needs Linux's /proc")
def test_no_descriptor_stays_open(tmp_path):
    write_text(tmp_path / "page.md", "x")
    before = len(os.listdir("/proc/self/fd"))
    for number in range(20):
        write_text(tmp_path / "page.md", str(number))
    assert len(os.listdir("/proc/self/fd")) == before
