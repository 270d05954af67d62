"""What drives robots: the neurocontroller, or any agent of a user's, a subclass of `Agent`."""

from .base import Agent

__all__ = ["Agent"]
