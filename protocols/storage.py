"""Files that are whole or absent: atomic writes, arrays with a digest, locks. No pickle."""

from __future__ import annotations

import contextlib
import fcntl
import hashlib
import json
import os
import re
import stat
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import safetensors
from safetensors.numpy import save

from .errors import DamagedFileError, InputError

# Largest files that are read: of arrays or rows, and of JSON.
MOST_BYTES, MOST_BYTES_OF_JSON = 2**34, 2**24
Shapes = Mapping[str, tuple[str, tuple[int, ...]]]
"""The dtype, as safetensors names it, and the shape of each array of a file."""

_DRAFT = re.compile(r"\..*\.\d+\.draft")


def check_place(path: Path) -> None:
    """Raises InputError if a file could not be written; called before the work on its content."""
    if path.is_dir():
        raise InputError(f"{path} is a folder")
    if not path.parent.is_dir():
        raise InputError(f"there is no folder {path.parent}")
    if not os.access(path.parent, os.W_OK | os.X_OK):
        raise InputError(f"{path.parent} cannot be written")


def check_folder(path: Path) -> None:
    """Raises InputError if a folder can neither be made nor written to."""
    while not path.exists():
        path = path.parent
    if not path.is_dir():
        raise InputError(f"{path} is not a folder")
    if not os.access(path, os.W_OK | os.X_OK):
        raise InputError(f"{path} cannot be written")


@contextlib.contextmanager
def locked(directory: Path) -> Iterator[None]:
    """Makes a folder and keeps other processes of musebot from working in it.

    Raises:
      InputError: another process works in it.
    """
    directory.mkdir(parents=True, exist_ok=True)
    handle = os.open(directory, os.O_RDONLY)
    try:
        try:
            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError as error:
            raise InputError(f"another musebot is running in {directory}") from error
        yield
    finally:
        os.close(handle)


def write_atomically(path: Path, content: bytes) -> None:
    """Writes a file so that readers, even after a crash, find the whole old or the whole new file.

    Raises:
      OSError: the file cannot be written; the old one is untouched.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    draft = path.with_name(f".{path.name}.{os.getpid()}.draft")
    try:
        with draft.open("wb") as file:
            file.write(content)
            file.flush()
            os.fsync(file.fileno())
        draft.replace(path)
    finally:
        draft.unlink(missing_ok=True)
    # The rename too must survive a power failure, before anything older is removed.
    folder = os.open(path.parent, os.O_RDONLY)
    try:
        os.fsync(folder)
    finally:
        os.close(folder)


def is_draft(path: Path) -> bool:
    """Returns whether a path is the temporary file of an interrupted write."""
    return _DRAFT.fullmatch(path.name) is not None


def remove_drafts(folder: Path) -> None:
    """Removes the temporary files of interrupted writes from a folder."""
    for path in folder.glob(".*"):
        if is_draft(path):
            path.unlink(missing_ok=True)


def save_arrays(path: Path, arrays: Mapping[str, np.ndarray], **notes: Any) -> None:
    """Writes arrays and JSON notes into one safetensors file, atomically, with a digest.

    Args:
      path: File to write.
      arrays: Arrays by name, of any shape and dtype that safetensors knows.
      **notes: Values that JSON can represent.

    Raises:
      OSError: the file cannot be written.
    """
    # Not ascontiguousarray, which would turn an array of shape () into one of shape (1,).
    contiguous = {name: np.asarray(array, order="C") for name, array in sorted(arrays.items())}
    text = json.dumps(notes, sort_keys=True)
    # One entry: safetensors writes several in no fixed order, and equal runs must leave equal
    # bytes.
    metadata = {"musebot": json.dumps({"notes": text, "digest": digest(contiguous, text)})}
    write_atomically(path, save(contiguous, metadata=metadata))


def read_whole(path: Path, most: int = MOST_BYTES) -> bytes:
    """Reads a regular file whose size is bounded: a pipe is refused, not waited for.

    Args:
      path: File to read.
      most: Largest size in bytes.

    Raises:
      FileNotFoundError: there is no such file.
      DamagedFileError: it is no regular file, is too large, or cannot be read.
    """
    check_file(path, most)
    try:
        return path.read_bytes()
    except OSError as error:
        raise DamagedFileError(f"{path} cannot be read ({error.strerror})") from error


def check_file(path: Path, most: int = MOST_BYTES) -> None:
    """Checks a file before it is read; see `read_whole`."""
    try:
        found = path.stat()
    except FileNotFoundError as error:
        raise FileNotFoundError(f"there is no file {path}") from error
    except (OSError, ValueError) as error:
        raise DamagedFileError(f"{path} cannot be read ({error})") from error
    if not stat.S_ISREG(found.st_mode):
        raise DamagedFileError(f"{path} is not a regular file")
    if found.st_size > most:
        raise DamagedFileError(f"{path} must have at most {most} bytes, got {found.st_size}")


def read_json(path: Path) -> Any:
    """Reads a file of JSON.

    Raises:
      FileNotFoundError: there is no such file.
      DamagedFileError: it is no regular file, too large, or no JSON.
    """
    return parsed(path, read_whole(path, MOST_BYTES_OF_JSON))


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
    """
    check_file(path)
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
    except (
        safetensors.SafetensorError, KeyError, ValueError, TypeError, AttributeError, OSError,
        MemoryError,
    ) as error:  # fmt: skip
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
        content.update(np.ascontiguousarray(array).tobytes())
    return content.hexdigest()
