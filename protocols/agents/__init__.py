"""Agents that drive the robots: the neurocontroller, or a user's own subclass of `Agent`."""

from .base import Agent

__all__ = ["Agent"]
