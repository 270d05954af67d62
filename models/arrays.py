"""Functions that take arrays of NumPy, or tensors of PyTorch on any device."""

from __future__ import annotations

from typing import Any

import numpy as np


def namespace(values: Any) -> Any:
    """Returns the module `torch` for tensors, else `numpy`: functions that have equal names."""
    if not _are_tensors(values):
        return np
    import torch  # not needed by those who only load a task

    return torch


# A number that becomes a tensor first would be a copy from the host in every call, on a GPU. The
# functions below hand the number to the kernel.


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
