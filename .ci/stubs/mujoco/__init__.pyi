"""MuJoCo's compiled modules carry no types: pyright is told that every name in them is Any."""

from typing import Any

def __getattr__(name: str) -> Any: ...
