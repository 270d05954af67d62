"""Arrays of NumPy or of a library on a GPU, computed by the same code."""

from __future__ import annotations

import functools
from typing import Any

import numpy as np
from array_api_compat import array_namespace


def namespace(array: Any) -> Any:
    """Returns `numpy` for its own arrays, else the array API of the array's library.

    NumPy's functions take less time than their counterparts of the array API, which wrap them.
    """
    return np if isinstance(array, np.ndarray) else array_namespace(array)


# The array API turns a number into an array first, which on a GPU is a copy from the host in every
# call. The functions below hand the number to the kernel.


def at_least(values: Any, lowest: float) -> Any:
    """Returns the values, raised to a number where they are below it; NaN stays."""
    return values.clamp(min=lowest) if _are_tensors(values) else np.maximum(values, lowest)


def at_most(values: Any, highest: float) -> Any:
    """Returns the values, lowered to a number where they are above it; NaN stays."""
    return values.clamp(max=highest) if _are_tensors(values) else np.minimum(values, highest)


def replaced(values: Any, where: Any, number: float) -> Any:
    """Returns the values, with a number in their place where a condition holds."""
    if _are_tensors(values):
        return values.masked_fill(where, number)
    return np.where(where, number, values)


def signs(values: Any) -> Any:
    """Returns -1, 0 or 1 for negative, zero and positive values."""
    return values.sign() if _are_tensors(values) else np.sign(values)


def interpolated(values: Any, known: np.ndarray, results: np.ndarray) -> Any:
    """Returns what `numpy.interp` returns, also for tensors; `known` points increase."""
    if not _are_tensors(values):
        return np.interp(values, known, results)
    xp = namespace(values)
    points, widths, slopes = _ramps(xp, tuple(known), tuple(results), values.dtype, values.device)
    ramps = xp.minimum(at_least(values[..., None] - points, 0.0), widths)
    return float(results[0]) + (ramps * slopes).sum(-1)


@functools.lru_cache
def _ramps(xp: Any, known: tuple, results: tuple, dtype: Any, device: Any) -> list[Any]:
    """Returns start, width and slope of each piece, as tensors that stay on the device."""
    widths = np.diff(known)
    pieces = np.array(known[:-1]), widths, np.diff(results) / widths
    return [xp.asarray(piece, dtype=dtype, device=device) for piece in pieces]


def as_numbers(condition: Any, dtype: Any) -> Any:
    """Returns 1 where a condition holds, else 0, in a floating-point type."""
    return condition.to(dtype) if _are_tensors(condition) else condition.astype(dtype)


_OF_NUMPY = np.ndarray | np.generic | float


def _are_tensors(values: Any) -> bool:
    return not isinstance(values, _OF_NUMPY)
