"""Stored brains run in robots again: evaluated, measured, filmed and shown in a window."""
