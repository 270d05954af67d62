"""Files are whole or absent, and a damaged file is never taken for a sound one."""

import gzip
import os
import secrets
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as npst
from safetensors.numpy import save

from musebot.protocols.errors import DamagedFileError, InputError, RunError
from musebot.protocols.storage import (
    DTYPES,
    check_folder,
    check_own_folder,
    checked_file,
    digest,
    draft_name,
    is_draft,
    load_arrays,
    locked,
    read_json,
    remove_drafts,
    remove_files,
    save_arrays,
    write_atomically,
    write_json,
    write_text,
)

ARRAYS = {
    "weights": np.linspace(-1, 1, 12, dtype=np.float32).reshape(3, 4),
    "age": np.array(500),
    "valid": np.array([True, False]),
    "nothing": np.zeros((0, 3)),
}
NOTES = {"step": 7, "random": {"state": 2**127, "name": "PCG64"}, "nothing": None}
OURS = ".file.0123456789abcdef.musebot"
arrays = st.dictionaries(
    st.text(max_size=20).filter(lambda name: name != "__metadata__" and name.isprintable()),
    st.sampled_from([*DTYPES]).flatmap(
        lambda dtype: npst.arrays(dtype, npst.array_shapes(min_dims=0, min_side=0, max_side=3))
    ),
    max_size=4,
)


def files(folder):
    return {path.name: path.read_bytes() for path in folder.iterdir()}


def equal(first, second):
    return first.keys() == second.keys() and all(
        (first[k].dtype, first[k].shape) == (second[k].dtype, second[k].shape)
        and first[k].tobytes() == second[k].tobytes()
        for k in first
    )


# Arrays


@given(
    st.sampled_from(["", ".gz"]),
    arrays,
    st.dictionaries(st.text(max_size=9), st.integers() | st.text(max_size=5)),
)
def test_arrays_and_notes_survive_the_file(tmp_path_factory, suffix, written, notes):
    notes = {name: value for name, value in notes.items() if name not in ("path", "arrays")}
    path = tmp_path_factory.mktemp("storage") / f"file{suffix}"
    save_arrays(path, written, **notes)
    read, said = load_arrays(path)
    assert equal(read, written) and said == notes
    again = path.with_name(f"again{suffix}")
    turned = {name: np.asarray(x, order="F") for name, x in reversed(written.items())}
    save_arrays(again, turned, **dict(reversed(notes.items())))
    assert again.read_bytes() == path.read_bytes()


def test_a_digest_depends_on_names_types_shapes_values_and_notes():
    numbers, first = np.arange(4.0), {"a": np.arange(4.0), "b": np.zeros((2, 2))}
    others = [
        {"c": numbers, "b": first["b"]},
        *(first | {"a": x} for x in (np.float32(numbers), numbers.reshape(2, 2), numbers + 1)),
    ]
    assert digest(first) == digest(dict(reversed(first.items())))
    assert len({digest(first), digest(first, "notes"), *map(digest, others)}) == 6


# Damage: one law for the readers of both kinds; tests/hostile puts what is no file in the place


@pytest.fixture(params=["file", "file.gz", "json"])
def sound(request, tmp_path):
    """A whole file, and its reader."""
    path = tmp_path / request.param
    if request.param != "json":
        save_arrays(path, ARRAYS, **NOTES)
        return path, load_arrays
    write_json(path, NOTES)
    return path, read_json


def refused(path, read):
    with pytest.raises(DamagedFileError) as caught:
        read(path)
    assert str(path) in str(caught.value) and len(str(caught.value)) < 500


def test_a_file_with_any_byte_flipped_cut_or_added_is_damaged(sound):
    path, read = sound
    whole, content = path.read_bytes(), read(path)
    for index in range(len(whole)):
        flipped = bytearray(whole)
        flipped[index] ^= 1 << (3 * index) % 8
        for changed in (bytes(flipped), whole[:index], whole[:index] + b"x" + whole[index:]):
            path.write_bytes(changed)
            try:
                same = repr(read(path)) == repr(content)
            except DamagedFileError as error:
                assert str(path) in str(error)
            else:
                assert same and path.name != "file", index  # a space, or the time in gzip
    path.write_bytes(whole + b"x")
    refused(path, read)
    path.write_bytes(whole)
    assert repr(read(path)) == repr(content)


def test_a_file_of_another_kind_is_damaged(sound):
    path, read = sound
    contents = [
        b"", b"robots", b"\0" * 100, b"\xff" * 64, b"[" * 100_000, b"1" * 5000, b"[]",
        b'{"a":' * 100_000, b'{"a": 1, "a": 2}', b'{"a": 1, "digest": "0"}', b"\xed\xa0\x80",
    ]  # fmt: skip
    texts = [
        '{"notes": ' + repr(content.decode(errors="replace")).replace("'", '"') + ', "digest": "0"}'
        for content in contents
    ]
    texts.append('{"notes": "[1]", "digest": "' + digest({"x": np.zeros(2)}, "[1]") + '"}')
    if read is load_arrays:  # safetensors with such metadata
        for metadata in (None, {}, {"notes": "{}"}, *({"musebot": text} for text in texts)):
            contents.append(save({"x": np.zeros(2)}, metadata=metadata))
    if path.suffix == ".gz":
        contents += [gzip.compress(content) for content in contents]
    for content in contents:
        path.write_bytes(content)
        refused(path, read)


def test_a_lack_of_memory_is_no_damage(tmp_path, monkeypatch):
    def lacks(*_):
        raise MemoryError

    save_arrays(tmp_path / "file", ARRAYS)
    monkeypatch.setattr(np, "ascontiguousarray", lacks)
    with pytest.raises(MemoryError):
        load_arrays(tmp_path / "file")


# Writing; tests/faults lets every call fail


def test_the_old_file_stays_until_the_new_one_is_whole_on_disk(tmp_path, monkeypatch):
    path = tmp_path / "folder" / "file"
    write_atomically(path, b"old")
    seen, fsync = [], os.fsync

    def look(descriptor):
        fsync(descriptor)
        seen.append(path.read_bytes())
        seen.extend(draft.read_bytes() for draft in path.parent.iterdir() if draft != path)

    monkeypatch.setattr(os, "fsync", look)
    write_atomically(path, b"new")
    # The draft is on disk before it replaces the old file, and the folder after it did.
    assert seen == [b"old", b"new", b"new"] and files(path.parent) == {"file": b"new"}


@pytest.mark.skipif(not Path("/proc/self/fd").is_dir(), reason="needs Linux's /proc")
def test_a_text_has_the_users_permissions_and_leaves_no_descriptor_open(tmp_path):
    before, held = os.umask(0o027), len(os.listdir("/proc/self/fd"))
    try:
        for _ in range(20):
            with locked(tmp_path):
                write_text(tmp_path / "page.md", "runs/\udcff, 10 µs")
    finally:
        os.umask(before)
    assert len(os.listdir("/proc/self/fd")) == held
    assert (tmp_path / "page.md").stat().st_mode & 0o777 == 0o640
    assert (tmp_path / "page.md").read_text(encoding="utf-8") == "runs/\\udcff, 10 µs"


# What is not ours


@pytest.fixture
def victim(tmp_path):
    """A folder of somebody else's that no command may touch."""
    folder = tmp_path / "victim"
    folder.mkdir()
    for name in ("file", ".novel.2024.draft", OURS):
        (folder / name).write_text("theirs")
    before = files(folder)
    yield folder
    assert files(folder) == before


def test_a_link_is_replaced_by_a_write_but_never_opened(tmp_path, victim, monkeypatch):
    (tmp_path / "file").symlink_to(victim / "file")
    write_atomically(tmp_path / "file", b"ours")
    assert not (tmp_path / "file").is_symlink() and (tmp_path / "file").read_bytes() == b"ours"
    assert len({draft_name("file") for _ in range(100)}) == 100  # which nobody can know
    monkeypatch.setattr(secrets, "token_hex", lambda count: "0123456789abcdef")
    (tmp_path / OURS).symlink_to(victim / "file")
    with pytest.raises(FileExistsError):
        write_atomically(tmp_path / "file", b"ours")


@pytest.mark.parametrize(
    "work",
    [
        lambda folder: write_atomically(folder / "file", b"ours"),
        lambda folder: remove_files(folder, lambda name: True),
        remove_drafts,
        check_own_folder,
        lambda folder: locked(folder).__enter__(),
    ],
)
def test_a_folder_that_is_a_link_or_a_file_is_refused(tmp_path, victim, work):
    link, file = tmp_path / "figures", tmp_path / "films"
    link.symlink_to(victim)
    file.write_text("theirs")
    for folder in (link, file):
        with pytest.raises((InputError, NotADirectoryError), match=str(folder)):
            work(folder)
    assert link.is_symlink() and file.read_text() == "theirs"


def test_drafts_and_files_of_ours_are_removed_and_nothing_else(tmp_path, victim):
    other, folder = ".a.0123456789abcdef.musebot", tmp_path / "own"
    folder.mkdir()
    kept = {"file": b"1", ".hidden": b"2", ".novel.2024.draft": b"3", f"{OURS}.txt": b"5"}
    for name, content in (kept | {OURS: b"4", other: b"6"}).items():
        (folder / name).write_bytes(content)
    (folder / ".link.0123456789abcdef.musebot").symlink_to(victim / "file")
    (folder / ".folder.0123456789abcdef.musebot").mkdir()
    assert {path.name for path in folder.iterdir() if is_draft(path)} == {OURS, other}
    remove_drafts(folder, "file")
    assert (folder / other).exists() and not (folder / OURS).exists()
    remove_drafts(folder)
    remove_files(folder, lambda name: name == "nowhere")
    remove_files(tmp_path / "nowhere", lambda name: True)
    left = {p.name: p.read_bytes() for p in folder.iterdir() if p.is_file() and not p.is_symlink()}
    assert left == kept and len([*folder.iterdir()]) == len(kept) + 2


# Places and locks


def test_a_place_for_a_file_is_checked_before_the_work(tmp_path, monkeypatch):
    (tmp_path / "loop").symlink_to("loop")
    with pytest.raises((InputError, OSError)):
        checked_file(tmp_path / "loop" / "file")
    (tmp_path / "link").symlink_to(tmp_path)
    file = checked_file(tmp_path / "link" / "file")  # the user may name a folder that is a link
    assert file == tmp_path / "file"
    os.mkfifo(tmp_path / "pipe")
    for path, words in (
        (tmp_path, "is a folder"),
        (tmp_path / "new" / "file", "new is no folder"),
        (tmp_path / "link", "is a link"),
        (tmp_path / "pipe", "is no regular file"),
    ):
        with pytest.raises(InputError, match=words):
            checked_file(path)
    monkeypatch.setattr(os, "access", lambda path, mode: False)
    with pytest.raises(InputError, match="cannot be written"):
        checked_file(file)


def test_a_folder_can_be_made_or_is_refused(tmp_path, monkeypatch):
    check_folder(tmp_path / "new" / "folder")
    (tmp_path / "file").write_text("")
    for name in ("file/below", "x/" * 1000, "x" * 300):
        with pytest.raises(InputError):
            check_folder(tmp_path / name)
    monkeypatch.setattr(os, "access", lambda path, mode: False)
    with pytest.raises(InputError, match="cannot be read and written"):
        check_folder(tmp_path / "new")


def test_a_locked_folder_is_refused_until_it_is_free(tmp_path):
    folder = tmp_path / "new" / "folder"
    with locked(folder):
        with pytest.raises(InputError, match=f"^another musebot is running in {folder}$"):
            with locked(folder):
                pass
    with locked(folder), pytest.raises(BlockingIOError), locked(tmp_path):
        raise BlockingIOError  # of the work, not of the lock
    assert files(folder) == {}


def test_a_folder_that_is_moved_during_the_work_is_named_with_its_new_place(tmp_path):
    out, moved = tmp_path / "out", tmp_path / "moved"
    with pytest.raises(RunError, match=f"{out} was moved or deleted .* lies in {moved}$"):
        with locked(out):
            write_text(out / "checkpoints" / "one", "1")
            out.rename(moved)
            write_text(out / "checkpoints" / "two", "2")
    assert not out.exists() and (moved / "checkpoints" / "one").exists()
    with pytest.raises(RunError, match="was moved or deleted during the work$"), locked(out):
        out.rmdir()
        (out / "x").read_text()
