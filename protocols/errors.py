"""What can go wrong, each in one sentence."""

from __future__ import annotations

EGL_REMEDY = "apt-get install libegl1 libegl-mesa0 libgl1-mesa-dri"


class InputError(Exception):
    """The user's request cannot be carried out; the text says why."""


class DamagedFileError(InputError):
    """A file of a run is truncated, altered or foreign; the text names it."""


class RunError(Exception):
    """A simulation could not continue; the text says why."""


class Interrupted(Exception):
    """A simulation was asked to stop; everything simulated so far is in its checkpoints."""
