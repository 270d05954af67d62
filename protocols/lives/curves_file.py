"""Reads curves.npz without trusting it: sizes and shapes are compared with the plan's first."""

from __future__ import annotations

import io
import zipfile
from pathlib import Path

import numpy as np

from ..errors import DamagedFileError
from ..storage import read_whole
from .plan import Plan

_MOST_BYTES_OF_HEADER = 4096


def read_curves(path: Path, plan: Plan) -> dict[str, np.ndarray]:
    """Reads the curves; sizes are compared with the plan's before anything is unpacked."""
    planned = {f"{condition}.npy": condition for condition in plan.conditions}
    minutes = {c: len(plan.experiment.schedule(c.task).steps_of_minutes()) for c in plan.conditions}
    sizes = [4 * n * minutes[c] + 2 * _MOST_BYTES_OF_HEADER for c, n in plan.robots.items()]
    content = read_whole(path, sum(sizes) + _MOST_BYTES_OF_HEADER)
    try:
        with zipfile.ZipFile(io.BytesIO(content)) as archive:
            members = archive.infolist()
            if len({member.filename for member in members}) < len(members):
                raise ValueError("an array is in it twice")
            curves = {}
            for member in members:
                if (condition := planned.get(member.filename)) is None:
                    raise ValueError(f"it has {member.filename}, which is not planned")
                most = (plan.robots[condition], minutes[condition])
                curves[str(condition)] = _curves(archive, member, most)
        return curves
    except Exception as error:  # zipfile, zlib and numpy each have many exceptions for damage
        raise DamagedFileError(f"{path} is damaged ({error})") from error


def _curves(archive: zipfile.ZipFile, member: zipfile.ZipInfo, most: tuple[int, int]) -> np.ndarray:
    """Returns the curves of a condition, of at most so many robots and exactly so many minutes."""
    robots, minutes = most
    name = member.filename.removesuffix(".npy")
    if member.file_size > robots * minutes * 4 + _MOST_BYTES_OF_HEADER:
        raise ValueError(f"{name} is larger than the curves of {robots} robots")
    with archive.open(member) as file:
        if np.lib.format.read_magic(file) != (1, 0):
            raise ValueError(f"{name} is of another version of numpy's format")
        shape, in_columns, dtype = np.lib.format.read_array_header_1_0(file)
        if dtype != np.float32 or len(shape) != 2 or shape[1] != minutes or shape[0] > robots:
            raise ValueError(
                f"{name} must be float32 of shape (N, {minutes}) with N up to {robots}, got "
                f"{dtype} of shape {shape}"
            )
        content = file.read()  # to the end, where zipfile compares the checksum
    array = np.frombuffer(content, dtype=np.float32).copy()
    return array.reshape(shape, order="F" if in_columns else "C")
