"""What can go wrong in an experiment, each said in one sentence. Light: it imports nothing."""


class InputError(Exception):
    """What the user asked for cannot be done; the text says why."""


class DamagedFileError(InputError):
    """A file of a run is truncated, altered or not one of ours; the text names it."""


class RunError(Exception):
    """A run could not go on; the text says why."""


class Interrupted(Exception):
    """A run was asked to stop; everything lived so far is in its checkpoints."""
