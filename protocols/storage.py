"""Files that are whole or absent: atomic writes, arrays with a digest, locks. No pickle.

All files that a command leaves are created, replaced and deleted by the functions of this module,
which follow no link below the folder that the user has named; but TensorBoard writes its own.
"""

from __future__ import annotations

import contextlib
import errno
import fcntl
import hashlib
import json
import os
import re
import secrets
import stat
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np
import safetensors
from safetensors.numpy import save

from .errors import DamagedFileError, InputError

# Bytes of OUT's path (the limit for its files is 4,096), and missing folders that are made.
_MOST_BYTES_OF_PATH, _MOST_MISSING = 3800, 100
_NEW = os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_NOFOLLOW
_NO_FILE = errno.ELOOP, errno.ENOTDIR, errno.ENAMETOOLONG  # errors of a path that names no file
# Largest files that are read: of arrays or rows, and of JSON.
MOST_BYTES, MOST_BYTES_OF_JSON = 2**34, 2**24
DTYPES: Mapping[np.dtype, str] = MappingProxyType(
    {
        np.dtype(name): short
        for name, short in (
            ("float16", "F16"), ("float32", "F32"), ("float64", "F64"), ("bool", "BOOL"),
            ("int8", "I8"), ("int16", "I16"), ("int32", "I32"), ("int64", "I64"),
            ("uint8", "U8"), ("uint16", "U16"), ("uint32", "U32"), ("uint64", "U64"),
        )
    }
)  # fmt: skip
"""Dtypes that a file can hold, and their names in safetensors."""

Shapes = Mapping[str, tuple[str, tuple[int, ...]]]
"""The dtype, as safetensors names it, and the shape of each array of a file."""

_DIGEST = "digest"  # of a file of JSON, in it
# A temporary file of an interrupted write: no name that anything else would give to a file.
_DRAFT = re.compile(r"\..*\.[0-9a-f]{16}\.musebot", re.DOTALL)


# ---- Checks before the work ----


def check_place(path: Path) -> None:
    """Raises InputError if a file could not be written; called before the work on its content."""
    if path.is_dir():
        raise InputError(f"{path} is a folder")
    if path.is_symlink():
        raise InputError(f"{path} is a link; name the file itself")
    if path.exists() and not path.is_file():
        raise InputError(f"{path} is no regular file")
    if not path.parent.is_dir():
        raise InputError(f"there is no folder {path.parent}")
    if not os.access(path.parent, os.W_OK | os.X_OK):
        raise InputError(f"{path.parent} cannot be written")


def resolved(path: Path) -> Path:
    """Returns the absolute path that a path's links lead to.

    Raises:
      InputError: its links lead in a circle.
    """
    try:
        return path.resolve()
    except RuntimeError as error:  # an OSError since Python 3.13
        raise InputError(f"the links of {path} lead in a circle") from error


def resolved_file(path: Path) -> Path:
    """Returns the absolute path of a file that the user has named, in a folder that is no link."""
    return resolved(path.parent) / path.name


def check_folder(path: Path) -> None:
    """Raises InputError if a folder can neither be made nor used."""
    if (size := len(os.fsencode(path.absolute()))) > _MOST_BYTES_OF_PATH:
        raise InputError(f"{path} must have at most {_MOST_BYTES_OF_PATH} bytes, got {size}")
    missing, path = 0, path.absolute()
    try:
        while not path.exists():
            missing, path = missing + 1, path.parent
    except OSError as error:  # of a folder above that cannot be searched
        raise InputError(f"{path} cannot be used ({error.strerror})") from error
    if missing > _MOST_MISSING:
        raise InputError(f"{missing} folders below {path} are missing, at most {_MOST_MISSING} may")
    if not path.is_dir():
        raise InputError(f"{path} is not a folder")
    if not os.access(path, os.R_OK | os.W_OK | os.X_OK):
        raise InputError(f"{path} cannot be {'read' if os.access(path, os.W_OK) else 'written'}")


def check_own_folder(path: Path) -> None:
    """Raises InputError where a folder below OUT is a link or a file, or cannot be written."""
    if path.is_symlink():
        raise InputError(f"{path} is a link, which musebot does not follow")
    check_folder(path)


# ---- The only functions that create, replace or delete files ----


@contextlib.contextmanager
def _opened(folder: Path) -> Iterator[int]:
    """Opens a folder that is no link; all that is done in it is done through the descriptor.

    Raises:
      InputError: it is a link or a file.
    """
    try:
        handle = os.open(folder, os.O_RDONLY | os.O_DIRECTORY | os.O_NOFOLLOW)
    except OSError as error:
        if folder.is_symlink() or error.errno == errno.ENOTDIR:
            check_own_folder(folder)
        raise
    try:
        yield handle
    finally:
        os.close(handle)


@contextlib.contextmanager
def locked(directory: Path) -> Iterator[None]:
    """Makes a folder and keeps other processes of musebot from working in it.

    The system releases the lock of a process that has ended, however it ended.

    Raises:
      InputError: another process works in it, or it is a link.
    """
    _make_folder(directory)
    with _opened(directory) as handle:
        try:
            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError as error:
            who = "" if (process := _lock_holder(handle)) is None else f" (process {process})"
            raise InputError(f"another musebot{who} is running in {directory}") from error
        yield


def _lock_holder(handle: int) -> int | None:
    """Returns the process that holds the lock of an open folder; None if the system hides it."""
    found = os.fstat(handle)
    device = f"{os.major(found.st_dev):02x}:{os.minor(found.st_dev):02x}"
    with contextlib.suppress(OSError, ValueError):
        for line in Path("/proc/locks").read_text().splitlines():
            # Such as "1: FLOCK  ADVISORY  WRITE 4711 fe:00:2163747 0 EOF".
            fields = line.split()
            if fields[1] == "FLOCK" and fields[5] == f"{device}:{found.st_ino}":
                return int(fields[4])
    return None


def write_atomically(path: Path, content: bytes) -> None:
    """Writes a file so that readers, even after a crash, find the whole old or the whole new file.

    No link is followed: a link at `path` is replaced, and a folder that is a link is refused.

    Raises:
      InputError: the folder is a link.
      OSError: the file cannot be written. The old one is then untouched, unless only the last
        flush failed, after the rename.
    """
    try:
        _write(path, content)
    except OSError as error:
        # Calls on descriptors do not name the file, and a rename names a temporary one.
        raise OSError(error.errno, error.strerror, str(path)) from error


def _write(path: Path, content: bytes) -> None:
    _make_folder(path.parent)
    with _opened(path.parent) as folder:
        draft = draft_name(path.name)
        handle = os.open(draft, _NEW, 0o666, dir_fd=folder)
        try:
            try:
                rest = memoryview(content)
                while rest:  # a call may write less than it was given
                    rest = rest[os.write(handle, rest) :]
                os.fsync(handle)
            finally:
                os.close(handle)
            os.replace(draft, path.name, src_dir_fd=folder, dst_dir_fd=folder)
        finally:
            with contextlib.suppress(FileNotFoundError):
                os.unlink(draft, dir_fd=folder)
        # The rename too must survive a power failure, before anything older is removed.
        os.fsync(folder)


def write_text(path: Path, text: str) -> None:
    """Writes a text as UTF-8, atomically; bytes of file names that are no text are escaped.

    Raises:
      InputError, OSError: see `write_atomically`.
    """
    write_atomically(path, text.encode(errors="backslashreplace"))


def create_empty(path: Path) -> None:
    """Makes an empty file where there is none.

    Raises:
      InputError: the folder is a link.
      OSError: it cannot be made.
    """
    with _opened(path.parent) as folder, contextlib.suppress(FileExistsError):
        os.close(os.open(path.name, _NEW, 0o666, dir_fd=folder))


def draft_name(name: str) -> str:
    """Returns a new name of a temporary file, which `remove_drafts` removes."""
    return f"{_draft_prefix(name)}{secrets.token_hex(8)}.musebot"


def is_draft(path: Path) -> bool:
    """Returns whether a path is the temporary file of an interrupted write."""
    return bool(_DRAFT.fullmatch(path.name)) and not path.is_symlink() and path.is_file()


def remove_drafts(folder: Path, of: str = "") -> None:
    """Removes the temporary files of interrupted writes from a folder.

    Args:
      folder: Folder in which no other process writes such files.
      of: Name of the file whose temporary files are removed; empty for those of all files.
    """
    begins = _draft_prefix(of) if of else ""
    remove_files(folder, lambda name: name.startswith(begins) and bool(_DRAFT.fullmatch(name)))


def _draft_prefix(name: str) -> str:
    return f".{name[:40]}."  # short enough for every file system, however long the name


def remove_files(folder: Path, ours: Callable[[str], bool]) -> None:
    """Removes files from a folder, neither links nor folders; does nothing without the folder.

    Args:
      folder: Folder.
      ours: Returns whether a file of a name is ours.

    Raises:
      InputError: the folder is a link.
      OSError: a file cannot be removed.
    """
    try:
        with _opened(folder) as handle:
            for name in filter(ours, os.listdir(handle)):
                with contextlib.suppress(FileNotFoundError):
                    if stat.S_ISREG(os.lstat(name, dir_fd=handle).st_mode):
                        os.unlink(name, dir_fd=handle)
    except FileNotFoundError:
        return


def _make_folder(folder: Path) -> None:
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except (FileExistsError, NotADirectoryError):
        check_own_folder(folder)
        raise


# ---- Arrays and notes ----


def save_arrays(path: Path, arrays: Mapping[str, np.ndarray], **notes: Any) -> None:
    """Writes arrays and JSON notes into one safetensors file, atomically, with a digest.

    Args:
      path: File to write.
      arrays: Arrays by name, of any shape and dtype that safetensors knows.
      **notes: Values that JSON can represent.

    Raises:
      OSError: the file cannot be written.
    """
    write_atomically(path, encoded_arrays(arrays, **notes))


def encoded_arrays(arrays: Mapping[str, np.ndarray], **notes: Any) -> bytes:
    """Returns the content of a file of arrays; see `save_arrays`."""
    # Not ascontiguousarray, which would turn an array of shape () into one of shape (1,).
    contiguous = {name: np.asarray(array, order="C") for name, array in sorted(arrays.items())}
    text = json.dumps(notes, sort_keys=True)
    # One entry: safetensors writes several in no fixed order, and equal runs must leave equal
    # bytes.
    metadata = {"musebot": json.dumps({"notes": text, "digest": digest(contiguous, text)})}
    return save(contiguous, metadata=metadata)


def read_whole(path: Path, most: int = MOST_BYTES) -> bytes:
    """Reads a regular file whose size is bounded: a pipe is refused, not waited for.

    Args:
      path: File to read.
      most: Largest size in bytes.

    Raises:
      FileNotFoundError: there is no such file.
      DamagedFileError: it is no regular file, or is too large.
      OSError: it cannot be read, which is no damage of it.
    """
    check_file(path, most)
    return path.read_bytes()


def check_file(path: Path, most: int = MOST_BYTES) -> None:
    """Checks a file before it is read; see `read_whole`."""
    try:
        found = path.stat()
    except FileNotFoundError as error:
        raise FileNotFoundError(f"there is no file {path}") from error
    except (OSError, ValueError) as error:
        if getattr(error, "errno", errno.ELOOP) not in _NO_FILE:  # may pass, as on a network
            raise
        raise DamagedFileError(f"{path} cannot be read ({error})") from error
    if not stat.S_ISREG(found.st_mode):
        raise DamagedFileError(f"{path} is not a regular file")
    if found.st_size > most:
        raise DamagedFileError(f"{path} must have at most {most} bytes, got {found.st_size}")


def write_json(path: Path, content: Mapping[str, Any]) -> None:
    """Writes an object of JSON atomically, with a digest of its other values.

    Raises:
      InputError, OSError: see `write_atomically`.
    """
    values = {name: value for name, value in content.items() if name != _DIGEST}
    text = json.dumps(values | {_DIGEST: _digest_of_json(values)}, indent=2)
    write_atomically(path, f"{text}\n".encode())


def read_json(path: Path) -> Any:
    """Reads a file of JSON; one that has a digest must match it, as earlier versions wrote none.

    Raises:
      FileNotFoundError: there is no such file.
      DamagedFileError: it is no regular file, too large, no JSON, or was changed.
    """
    content = parsed(path, read_whole(path, MOST_BYTES_OF_JSON))
    if isinstance(content, dict) and _DIGEST in content:
        values = {name: value for name, value in content.items() if name != _DIGEST}
        if content[_DIGEST] != _digest_of_json(values):
            raise DamagedFileError(f"{path} was changed after musebot had written it")
    return content


def _digest_of_json(values: Mapping[str, Any]) -> str:
    return digest_of(json.dumps(values, sort_keys=True).encode())


def digest_of(content: bytes) -> str:
    """Returns the SHA-256 digest of a file's content, 64 hexadecimal digits."""
    return hashlib.sha256(content).hexdigest()


def digest_of_file(path: Path) -> str:
    """Returns the SHA-256 digest of a file.

    Raises:
      FileNotFoundError: there is no such file.
      DamagedFileError: it is no regular file, or is too large.
      OSError: it cannot be read.
    """
    check_file(path)
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def parsed(path: Path, text: str | bytes) -> Any:
    """Returns the value of a text of JSON.

    Args:
      path: File that holds the text.
      text: JSON, in UTF-8.

    Raises:
      DamagedFileError: it is no JSON, too deeply nested, or has a number of too many digits.
    """
    try:
        return json.loads(text)
    except RecursionError as error:
        raise DamagedFileError(f"{path} is damaged (its JSON is nested too deeply)") from error
    except ValueError as error:
        raise DamagedFileError(f"{path} is damaged ({error})") from error


def load_arrays(
    path: Path, check: Callable[[Shapes], None] | None = None
) -> tuple[dict[str, np.ndarray], dict[str, Any]]:
    """Reads what `save_arrays` wrote: the arrays and the notes.

    Args:
      path: File to read.
      check: Raises ValueError where the file must not be read. It receives the dtype and the
        shape of each array before any array is read.

    Raises:
      FileNotFoundError: there is no such file.
      DamagedFileError: the file is truncated, altered or foreign.
      OSError: it cannot be read.
    """
    check_file(path)
    path.open("rb").close()  # safetensors calls a file that cannot be opened an invalid one
    try:
        with safetensors.safe_open(path, framework="numpy") as file:
            metadata = parsed(path, (file.metadata() or {})["musebot"])
            names = sorted(file.keys())
            if check is not None:
                slices = {name: file.get_slice(name) for name in names}
                check({k: (x.get_dtype(), tuple(x.get_shape())) for k, x in slices.items()})
            arrays = {name: file.get_tensor(name) for name in names}
        sound = metadata["digest"] == digest(arrays, metadata["notes"])
        notes = parsed(path, metadata["notes"])
    except DamagedFileError:
        raise
    except (safetensors.SafetensorError, KeyError, ValueError, TypeError, AttributeError) as error:
        raise DamagedFileError(f"{path} is damaged ({error})") from error
    if not sound:
        raise DamagedFileError(f"{path} is damaged (its content does not match its digest)")
    if not isinstance(notes, dict):
        raise DamagedFileError(f"{path} is damaged (its notes are no object of JSON)")
    return arrays, notes


def digest(arrays: Mapping[str, np.ndarray], notes: str = "") -> str:
    """Returns 32 hexadecimal digits that identify arrays and notes."""
    content = hashlib.blake2b(notes.encode(), digest_size=16)
    for name, array in sorted(arrays.items()):
        content.update(f"{name} {array.dtype.str} {array.shape}".encode())
        content.update(np.ascontiguousarray(array).data)
    return content.hexdigest()
