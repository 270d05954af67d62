"""Files that are whole or absent: atomic writes, arrays with a digest, locks. No pickle.

All files that a command leaves are created, replaced and deleted by the functions of this module,
which follow no link below the folder that the user has named; but TensorBoard writes its own.
"""

from __future__ import annotations

import contextlib
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

from .errors import DamagedFileError, InputError, RunError

_MOST_BYTES_OF_PATH = 1000  # of OUT
_MOST_BYTES_OF_JSON = 2**24  # a larger file is not read
_BITS = {"float": (16, 32, 64), "int": (8, 16, 32, 64), "uint": (8, 16, 32, 64)}
DTYPES: Mapping[np.dtype, str] = MappingProxyType(
    {np.dtype(f"{kind}{n}"): f"{kind[0].upper()}{n}" for kind in _BITS for n in _BITS[kind]}
    | {np.dtype(bool): "BOOL"}
)
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
    path = path.absolute()
    if (size := len(os.fsencode(path))) > _MOST_BYTES_OF_PATH:
        raise InputError(f"{path} must have at most {_MOST_BYTES_OF_PATH} bytes, got {size}")
    try:
        while not path.exists():
            path = path.parent
    except OSError as error:  # of a folder above that cannot be searched
        raise InputError(f"{path} cannot be used ({error.strerror})") from error
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
def locked(directory: Path) -> Iterator[None]:
    """Makes a folder and keeps other processes of musebot from working in it.

    The system releases the lock of a process that has ended, however it ended.

    Raises:
      InputError: another process works in it, or it is a link or a file.
      RunError: it was moved or deleted during the work.
    """
    check_own_folder(directory)
    directory.mkdir(parents=True, exist_ok=True)
    handle = os.open(directory, os.O_RDONLY)
    try:
        try:
            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError as error:
            raise InputError(f"another musebot is running in {directory}") from error
        try:
            yield
        except (OSError, InputError, RunError) as error:
            if directory.exists() and os.path.samestat(directory.stat(), os.fstat(handle)):
                raise
            raise RunError(_moved(directory, handle)) from error
    finally:
        os.close(handle)


def _moved(directory: Path, handle: int) -> str:
    """Returns a sentence about an open folder that is no longer at its path."""
    place = Path(f"/proc/self/fd/{handle}")
    found = place.readlink() if place.is_symlink() else None  # Linux knows
    if found is None or not found.exists():
        return f"{directory} was moved or deleted during the work"
    return f"{directory} was moved during the work; what is done lies in {found}"


def write_atomically(path: Path, content: bytes) -> None:
    """Writes a file so that readers, even after a crash, find the whole old or the whole new file.

    A folder is made in an existing one only: one that was moved away is not made again. A link at
    `path` is replaced.

    Raises:
      InputError: the folder is a link or a file.
      OSError: the file cannot be written. The old one is then untouched, unless only the last
        flush failed, after the rename.
    """
    folder, draft = path.parent, path.with_name(draft_name(path.name))
    try:
        if folder.is_symlink() or not folder.is_dir():
            check_own_folder(folder)
            folder.mkdir(exist_ok=True)
        try:
            with open(draft, "xb") as file:
                file.write(content)
                file.flush()
                os.fsync(file.fileno())
            os.replace(draft, path)
        finally:
            with contextlib.suppress(FileNotFoundError):
                os.unlink(draft)
        # The rename too must survive a power failure, before anything older is removed.
        handle = os.open(folder, os.O_RDONLY)
        try:
            os.fsync(handle)
        finally:
            os.close(handle)
    except OSError as error:
        # A rename names a temporary file, and calls on descriptors name none.
        raise OSError(error.errno, error.strerror, str(path)) from error


def write_text(path: Path, text: str) -> None:
    """Writes a text as UTF-8, atomically; bytes of file names that are no text are escaped.

    Raises:
      InputError, OSError: see `write_atomically`.
    """
    write_atomically(path, text.encode(errors="backslashreplace"))


def create_empty(path: Path) -> None:
    """Makes an empty file where there is none; raises OSError where it cannot be made."""
    with contextlib.suppress(FileExistsError):
        open(path, "xb").close()


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
    if folder.is_symlink():
        check_own_folder(folder)
    with contextlib.suppress(FileNotFoundError):
        for name in filter(ours, os.listdir(folder)):
            with contextlib.suppress(FileNotFoundError):
                if stat.S_ISREG(os.lstat(folder / name).st_mode):
                    os.unlink(folder / name)


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
    # Not ascontiguousarray, which would turn an array of shape () into one of shape (1,).
    contiguous = {name: np.asarray(array, order="C") for name, array in sorted(arrays.items())}
    text = json.dumps(notes, sort_keys=True)
    # One entry: safetensors writes several in no fixed order, and equal runs must leave equal
    # bytes.
    metadata = {"musebot": json.dumps({"notes": text, "digest": digest(contiguous, text)})}
    write_atomically(path, save(contiguous, metadata=metadata))


def load_arrays(
    path: Path,
    check: Callable[[Shapes], None] | None = None,
    wanted: Callable[[str], bool] | None = None,
) -> tuple[dict[str, np.ndarray], dict[str, Any]]:
    """Reads what `save_arrays` wrote: the arrays and the notes. The digest is that of all arrays.

    Args:
      path: File to read.
      check: Raises ValueError where the file must not be read. It receives the dtype and the
        shape of each array before any array is read.
      wanted: Returns whether an array of a name is kept in memory; None keeps all.

    Raises:
      FileNotFoundError: there is no such file.
      DamagedFileError: the file is truncated, altered or foreign.
      OSError: it cannot be read.
    """
    check_file(path)
    path.open("rb").close()  # safetensors calls a file that cannot be opened an invalid one
    arrays: dict[str, np.ndarray] = {}
    try:
        with safetensors.safe_open(path, framework="numpy") as file:
            metadata = parsed(path, (file.metadata() or {})["musebot"])
            names = sorted(file.keys())
            if check is not None:
                slices = {name: file.get_slice(name) for name in names}
                check({k: (x.get_dtype(), tuple(x.get_shape())) for k, x in slices.items()})
            content = _digest_of_notes(metadata["notes"])
            for name in names:
                array = file.get_tensor(name)
                _add_array(content, name, array)
                if wanted is None or wanted(name):
                    arrays[name] = array
        sound = metadata["digest"] == content.hexdigest()
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
    content = _digest_of_notes(notes)
    for name, array in sorted(arrays.items()):
        _add_array(content, name, array)
    return content.hexdigest()


def _digest_of_notes(notes: str) -> Any:
    return hashlib.blake2b(notes.encode(), digest_size=16)


def _add_array(content: Any, name: str, array: np.ndarray) -> None:
    content.update(f"{name} {array.dtype.str} {array.shape}".encode())
    content.update(np.ascontiguousarray(array).data)


# ---- JSON ----


def check_file(path: Path) -> None:
    """Checks that a file can be read: a pipe is refused, not waited for.

    Raises:
      FileNotFoundError: there is no such file.
      DamagedFileError: it is no regular file.
      OSError: it cannot be read, which is no damage of it.
    """
    try:
        mode = path.stat().st_mode
    except FileNotFoundError as error:
        raise FileNotFoundError(f"there is no file {path}") from error
    if not stat.S_ISREG(mode):
        raise DamagedFileError(f"{path} is not a regular file")


def read_whole(path: Path, most: int = _MOST_BYTES_OF_JSON) -> bytes:
    """Reads a regular file of at most so many bytes; raises as `check_file`."""
    check_file(path)
    with path.open("rb") as file:
        content = file.read(most + 1)
    if len(content) > most:
        raise DamagedFileError(f"{path} must have at most {most} bytes")
    return content


def write_json(path: Path, content: Mapping[str, Any]) -> None:
    """Writes an object of JSON atomically, with a digest of its other values.

    Raises:
      InputError, OSError: see `write_atomically`.
    """
    values = {name: value for name, value in content.items() if name != _DIGEST}
    text = json.dumps(values | {_DIGEST: _digest_of_json(values)}, indent=2)
    write_atomically(path, f"{text}\n".encode())


def read_json(path: Path) -> dict[str, Any]:
    """Reads what `write_json` wrote, with the digest.

    Raises:
      FileNotFoundError: there is no such file.
      DamagedFileError: it is no regular file, too large, no such JSON, or was changed.
      OSError: it cannot be read.
    """
    content = parsed(path, read_whole(path))
    if not isinstance(content, dict) or _DIGEST not in content:
        raise DamagedFileError(f"{path} is damaged (it has no digest)")
    values = {name: value for name, value in content.items() if name != _DIGEST}
    if content[_DIGEST] != _digest_of_json(values):
        raise DamagedFileError(f"{path} was changed after musebot had written it")
    return content


def _digest_of_json(values: Mapping[str, Any]) -> str:
    return hashlib.sha256(json.dumps(values, sort_keys=True).encode()).hexdigest()


def parsed(path: Path, text: str | bytes) -> Any:
    """Returns the value of a text of JSON in UTF-8, which a file holds.

    Raises:
      DamagedFileError: it is no JSON, too deeply nested, has a number of too many digits, or a
        name twice.
    """
    try:
        return json.loads(text, object_pairs_hook=_object)
    except RecursionError as error:
        raise DamagedFileError(f"{path} is damaged (its JSON is nested too deeply)") from error
    except ValueError as error:
        raise DamagedFileError(f"{path} is damaged ({error})") from error


def _object(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    found = dict(pairs)
    if len(found) < len(pairs):
        raise ValueError("a name is given twice")
    return found
