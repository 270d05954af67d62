"""What can go wrong, each said in one sentence, and the status with which a command ends.

Light: it imports nothing of ours before there is work to do.
"""

from __future__ import annotations

import os
import signal
import sys
from collections.abc import Callable
from typing import NoReturn

EGL_REMEDY = "apt-get install libegl1 libegl-mesa0 libgl1-mesa-dri"


class InputError(Exception):
    """What the user asked for cannot be done; the text says why."""


class DamagedFileError(InputError):
    """A file of a run is truncated, altered or not one of ours; the text names it."""


class RunError(Exception):
    """A run could not go on; the text says why."""


class Interrupted(Exception):
    """A run was asked to stop; everything lived so far is in its checkpoints."""


def exit_status(work: Callable[[], None], *, check: bool = True) -> int:
    """Does what was asked for; says in one sentence why it cannot, and returns the exit status.

    Args:
      work: to do.
      check: whether the versions of what it stands on are checked first.
    """
    try:
        if check:
            from ..models import check_versions

            check_versions()
        work()
        if sys.stdout:  # there is none where it was closed
            sys.stdout.flush()
    except (InputError, ImportError) as error:
        return complain(str(error), 2)
    except BrokenPipeError:  # who reads has read enough, as `head` does
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 128 + signal.SIGPIPE
    except (RunError, OSError) as error:
        return complain(str(error), 1)
    except Interrupted:
        return complain("stopped; the same command goes on from here", 130)
    except KeyboardInterrupt:
        return complain("stopped", 130)
    return 0


def run_module(main: Callable[..., None]) -> NoReturn:
    """What `python -m musebot.protocols.NAME` does: `main`, told by the command line; ends here.

    Args:
      main: its parameters are the options, its docstring is their help.
    """
    import tyro

    name = sys.modules["__main__"].__spec__.name  # type: ignore[union-attr]
    sys.exit(exit_status(lambda: tyro.cli(main, prog=f"python -m {name}")))


def complain(sentence: str, status: int) -> int:
    """Says on stderr what went wrong; returns the exit status that it was given."""
    print(f"musebot: {sentence}", file=sys.stderr)
    return status
