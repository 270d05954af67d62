"""Agents that drive the robots: the neurocontroller, or a user's own subclass of `Agent`."""

from ... import controller as _controller  # noqa: F401  without torch it says how to get it
from .base import Agent

__all__ = ["Agent"]
