"""The robot's brain: an evaluation network and a creative memory. Depends on NumPy and torch.

Parameters, those of the named brains included, need no torch; all other classes do.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

from ..extras import extra_needed
from .parameters import PROPOSERS, Parameters
from .presets import BRAINS, INGREDIENTS

if TYPE_CHECKING:
    from .neurocontroller import Neurocontroller
    from .senses import Senses, Signal

__all__ = [
    "BRAINS",
    "INGREDIENTS",
    "PROPOSERS",
    "Neurocontroller",
    "Parameters",
    "Senses",
    "Signal",
]

_NEED_TORCH = {
    "Neurocontroller": "neurocontroller",
    "Senses": "senses",
    "Signal": "senses",
}


def __getattr__(name: str) -> Any:
    """Imports the names that need torch when they are first used."""
    if name not in _NEED_TORCH:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    with extra_needed():
        return getattr(importlib.import_module(f".{_NEED_TORCH[name]}", __name__), name)
