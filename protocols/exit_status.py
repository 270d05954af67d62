"""The exit status of a command, and the one sentence that explains a failure.

Light to import: it loads nothing else of musebot.
"""

from __future__ import annotations

import os
import signal
import sys
from collections.abc import Callable

from .errors import InputError, Interrupted, RunError


def exit_status(work: Callable[[], None], *, check: bool = True) -> int:
    """Carries out a command, reports a failure in one sentence, and returns the exit status.

    Args:
      work: Command to carry out.
      check: Whether to check the versions of the dependencies first.

    Returns:
      0, 1 for a failure, 2 for bad input, 130 for Ctrl-C, 141 for a closed pipe.
    """
    try:
        if check:
            from ..models import check_versions

            check_versions()
        work()
        if sys.stdout:  # None where it was closed
            sys.stdout.flush()
    except (InputError, ImportError) as error:
        return complain(str(error), 2)
    except BrokenPipeError:  # the reader has read enough, as `head` does
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 128 + signal.SIGPIPE
    except (RunError, OSError) as error:
        return complain(str(error), 1)
    except Interrupted:
        return complain("stopped; the same command continues from here", 130)
    except KeyboardInterrupt:
        return complain("stopped", 130)
    return 0


def complain(sentence: str, status: int) -> int:
    """Prints on stderr what went wrong; returns the given exit status."""
    print(f"musebot: {sentence}", file=sys.stderr)
    return status
