"""Functions that take arrays of NumPy, or of a library that computes on a GPU."""

from __future__ import annotations

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
    """Returns the larger of each value and `lowest`; NaN stays."""
    return values.clamp(min=lowest) if _are_tensors(values) else np.maximum(values, lowest)


def at_most(values: Any, highest: float) -> Any:
    """Returns the smaller of each value and `highest`; NaN stays."""
    return values.clamp(max=highest) if _are_tensors(values) else np.minimum(values, highest)


def replaced(values: Any, where: Any, number: float) -> Any:
    """Returns the values, replaced by `number` where the condition `where` holds."""
    if _are_tensors(values):
        return values.masked_fill(where, number)
    return np.where(where, number, values)


def as_numbers(condition: Any, dtype: Any) -> Any:
    """Returns 1 where a condition holds, else 0, in the floating-point type `dtype`."""
    return condition.to(dtype) if _are_tensors(condition) else condition.astype(dtype)


_OF_NUMPY = np.ndarray | np.generic | float


def _are_tensors(values: Any) -> bool:
    return not isinstance(values, _OF_NUMPY)
