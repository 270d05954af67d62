"""Agents that drive robots: the paper's brain, other learners, fixed policies, users' agents."""

from ... import controller as _controller  # noqa: F401  without torch it says how to get it
from .base import Agent

__all__ = ["Agent"]
