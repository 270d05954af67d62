"""Arrays of NumPy or of a library on a GPU, computed by the same code."""

from __future__ import annotations

from typing import Any

import numpy as np
from array_api_compat import array_namespace


def namespace(array: Any) -> Any:
    """Returns `numpy` for its own arrays, else the array API of the array's library.

    NumPy's functions take less time than their counterparts of the array API, which wrap them.
    """
    return np if isinstance(array, np.ndarray) else array_namespace(array)
