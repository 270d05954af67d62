"""Writes files that are whole or absent: atomic writes, arrays with a digest, locks; no pickle.

The functions of this module create, replace and delete all files of a command, and follow no link
below the folder that the user has named. Only TensorBoard writes files of its own, and
`checkpoints.set_aside` renames damaged ones.
"""

from __future__ import annotations

import contextlib
import fcntl
import gzip
import hashlib
import json
import os
import re
import secrets
import stat
import zlib
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import IO, Any

import numpy as np
import safetensors
from safetensors.numpy import load, save

from ..fields import shown
from .errors import DamagedFileError, InputError, RunError

_MOST_BYTES_OF_PATH = 1000  # of OUT, the folder named by the user
_MOST_BYTES = 2**24  # of a text or of JSON; a larger file is not read
_BITS = {"float": (16, 32, 64), "int": (8, 16, 32, 64), "uint": (8, 16, 32, 64)}
DTYPES = np.dtype(bool), *(np.dtype(f"{kind}{n}") for kind in _BITS for n in _BITS[kind])
"""Dtypes that a file can hold."""

_NO_ARRAYS = safetensors.SafetensorError, KeyError, ValueError, TypeError, AttributeError
_NOT_GZIP = gzip.BadGzipFile, EOFError, zlib.error
_DIGEST = "digest"  # key of a JSON file's digest, which is in the file
# Name of a temporary file, which an interrupted write leaves; nothing else has such names.
_DRAFT = re.compile(r"\.(.*)\.[0-9a-f]{16}\.musebot", re.DOTALL)
_LONGEST = 40  # characters of a file's name in that of its temporary file; long names can fail


# ---- Checks before the work ----


def checked_file(path: Path) -> Path:
    """Returns a file's absolute path with links in its folder resolved.

    Called before the file's content is computed.

    Raises:
      InputError: the file cannot be written, or is a link.
    """
    path = resolved(path.parent) / path.name
    if not os.access(path.parent, os.W_OK | os.X_OK):
        missing = "cannot be written" if os.path.isdir(path.parent) else "is no folder"
        raise InputError(f"{path.parent} {missing}")
    if path.is_symlink() or (path.exists() and not path.is_file()):
        kind = "a link" if path.is_symlink() else "a folder" if path.is_dir() else "no regular file"
        raise InputError(f"{path} is {kind}; name a file")
    return path


def resolved(path: Path) -> Path:
    """Returns the absolute path with links resolved; raises InputError if they form a circle."""
    try:
        return path.resolve()
    except RuntimeError as error:  # an OSError since Python 3.13
        raise InputError(f"the links of {path} lead in a circle") from error


def check_folder(path: Path) -> None:
    """Raises InputError if a folder can neither be made nor used."""
    path = path.absolute()
    if (size := len(os.fsencode(path))) > _MOST_BYTES_OF_PATH:
        raise InputError(f"{path} must have at most {_MOST_BYTES_OF_PATH} bytes, got {size}")
    try:
        while not path.exists():
            path = path.parent
    except OSError as error:  # a folder above cannot be searched
        raise InputError(f"{path} cannot be used ({error.strerror})") from error
    if not path.is_dir():
        raise InputError(f"{path} is not a folder")
    if not os.access(path, os.R_OK | os.W_OK | os.X_OK):
        raise InputError(f"{path} cannot be read and written")


def check_own_folder(path: Path) -> None:
    """Raises InputError if a folder below OUT is a link or a file, or cannot be written."""
    if path.is_symlink():
        raise InputError(f"{path} is a link, which musebot does not follow")
    check_folder(path)


# ---- The only functions that create, replace or delete files ----


@contextlib.contextmanager
def locked(directory: Path) -> Iterator[None]:
    """Makes a folder, and keeps other musebot processes out of it while this context lasts.

    Raises:
      InputError: another process works in the folder, or it is a link or a file.
      RunError: the folder was moved or deleted during the work.
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
            place = Path(f"/proc/self/fd/{handle}")  # Linux knows where the folder is now
            found = place.readlink() if place.is_symlink() else None
            where = f"; what is done lies in {found}" if found and found.exists() else ""
            raise RunError(f"{directory} was moved or deleted during the work{where}") from error
    finally:
        os.close(handle)


def write_atomically(path: Path, content: bytes) -> None:
    """Writes a file so that readers, even after a crash, find the whole old or the whole new file.

    The file's folder is made only if the folder above it exists: after a run's folder was moved
    away, a checkpoint must not make a new one. A link at `path` is replaced.

    Raises:
      InputError: the folder is a link or a file.
      OSError: the file cannot be written. The old file then remains, unless only the flush after
        the rename failed.
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
        # The rename, too, must survive a power failure before anything older is removed.
        handle = os.open(folder, os.O_RDONLY)
        try:
            os.fsync(handle)
        finally:
            os.close(handle)
    except OSError as error:
        # A rename's error names the temporary file, and a descriptor's error names none.
        raise OSError(error.errno, error.strerror, str(path)) from error


def write_text(path: Path, text: str) -> None:
    """Writes a text as UTF-8, atomically; bytes of file names that are not UTF-8 are escaped."""
    write_atomically(path, text.encode(errors="backslashreplace"))


def draft_name(name: str) -> str:
    """Returns a new name of a temporary file, which `remove_drafts` removes."""
    return f".{name[:_LONGEST]}.{secrets.token_hex(8)}.musebot"


def is_draft(path: Path) -> bool:
    """Returns whether a path is the temporary file of an interrupted write."""
    return bool(_DRAFT.fullmatch(path.name)) and not path.is_symlink() and path.is_file()


def remove_drafts(folder: Path, of: str = "") -> None:
    """Removes a folder's temporary files of interrupted writes: those of the file `of`, or all.

    No other process may be writing in the folder.
    """

    def ours(name: str) -> bool:
        draft = _DRAFT.fullmatch(name)
        return draft is not None and of[:_LONGEST] in ("", draft[1])

    remove_files(folder, ours)


def remove_files(folder: Path, ours: Callable[[str], bool]) -> None:
    """Removes a folder's files for whose names `ours` is true; leaves links and folders.

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
      path: File to write; an existing one is replaced. If its name ends in .gz, it is compressed.
      arrays: Arrays by name, of any shape and a dtype of `DTYPES`.
      **notes: Notes by name: values that JSON can represent.
    """
    # Not ascontiguousarray, which would turn an array of shape () into one of shape (1,).
    contiguous = {name: np.asarray(array, order="C") for name, array in sorted(arrays.items())}
    text = json.dumps(notes, sort_keys=True)
    # One entry: safetensors writes several in no fixed order, but equal runs must give equal bytes.
    metadata = {"musebot": json.dumps({"notes": text, "digest": digest(contiguous, text)})}
    content = save(contiguous, metadata=metadata)
    if path.suffix == ".gz":
        content = gzip.compress(content, compresslevel=6, mtime=0)
    write_atomically(path, content)


def load_arrays(path: Path) -> tuple[dict[str, np.ndarray], dict[str, Any]]:
    """Reads the arrays and the notes that `save_arrays` wrote.

    Raises:
      FileNotFoundError: there is no such file.
      DamagedFileError: the file is truncated, altered or of another kind.
      OSError: the file cannot be read.
    """
    with _opened(path) as file:
        content = file.read()
    try:
        if path.suffix == ".gz":
            content = gzip.decompress(content)
        arrays = dict(sorted(load(content).items()))
        header = parsed(path, content[8 : 8 + int.from_bytes(content[:8], "little")])
        metadata = parsed(path, header["__metadata__"]["musebot"])
        if metadata["digest"] != digest(arrays, metadata["notes"]):
            raise ValueError("its content does not match its digest")
        if not isinstance(notes := parsed(path, metadata["notes"]), dict):
            raise ValueError("its notes are no object of JSON")
    except (*_NO_ARRAYS, *_NOT_GZIP) as error:
        raise DamagedFileError(f"{path} is damaged ({error})") from error
    return arrays, notes


def digest(arrays: Mapping[str, np.ndarray], notes: str = "") -> str:
    """Returns 32 hexadecimal digits that identify arrays and notes."""
    content = hashlib.blake2b(notes.encode(), digest_size=16)
    for name, array in sorted(arrays.items()):
        content.update(f"{name} {array.dtype.str} {array.shape}".encode())
        content.update(np.ascontiguousarray(array).data)
    return content.hexdigest()


def _opened(path: Path) -> IO[bytes]:
    """Opens a regular file for reading; raises DamagedFileError for a pipe, without waiting."""
    try:
        mode = path.stat().st_mode
    except FileNotFoundError as error:
        raise FileNotFoundError(f"there is no file {path}") from error
    if not stat.S_ISREG(mode):
        raise DamagedFileError(f"{path} is not a regular file")
    return path.open("rb")


# ---- JSON ----


def read_whole(path: Path) -> bytes:
    """Reads a file of at most 16 MiB; raises the errors of `read_json`."""
    with _opened(path) as file:
        content = file.read(_MOST_BYTES + 1)
    if len(content) > _MOST_BYTES:
        raise DamagedFileError(f"{path} must have at most {_MOST_BYTES} bytes")
    return content


def write_json(path: Path, content: Mapping[str, Any]) -> None:
    """Writes an object of JSON atomically, with a digest of its other values."""
    write_atomically(path, f"{json.dumps(_signed(content), indent=2)}\n".encode())


def read_json(path: Path) -> dict[str, Any]:
    """Reads an object that `write_json` wrote, with its digest, and checks the digest.

    Raises:
      FileNotFoundError: there is no such file.
      DamagedFileError: the file is not regular, too large, no such JSON, or was changed.
      OSError: the file cannot be read.
    """
    content = parsed(path, read_whole(path))
    if not isinstance(content, dict) or content != _signed(content):
        raise DamagedFileError(f"{path} was changed after musebot had written it")
    return content


def _signed(content: Mapping[str, Any]) -> dict[str, Any]:
    """Returns an object of JSON with the digest of its other values."""
    values = {name: value for name, value in content.items() if name != _DIGEST}
    text = json.dumps(values, sort_keys=True)
    return values | {_DIGEST: hashlib.sha256(text.encode()).hexdigest()}


def parsed(path: Path, text: str | bytes) -> Any:
    """Returns the value of a JSON text (bytes: UTF-8); errors name the text's file, `path`.

    Raises:
      DamagedFileError: the text is no JSON, is nested too deeply, or has a number with too many
        digits or a name twice.
    """
    try:
        return json.loads(text, object_pairs_hook=_object)
    except (ValueError, RecursionError) as error:
        raise DamagedFileError(f"{path} is damaged ({error})") from error


def _object(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    found: dict[str, Any] = {}
    for name, value in pairs:
        if name in found:
            raise ValueError(f"{shown(name)} is given twice")
        found[name] = value
    return found
