"""The exit status of a command, and the one sentence that explains a failure."""

from __future__ import annotations

import errno
import os
import signal
import sys
from collections.abc import Callable

from ..extras import missing_extra
from .errors import InputError, Interrupted, RunError
from .terminal import notice

# Error numbers of the system that mean a wrong path, and so bad input.
_BAD_PATH = {errno.EISDIR, errno.ENOTDIR, errno.ELOOP, errno.ENAMETOOLONG, errno.EILSEQ}


def exit_status(work: Callable[[], None]) -> int:
    """Carries out a command, prints a failure as one sentence, and returns the exit status.

    Args:
      work: Function that carries out the command.

    Returns:
      0 for success, 1 for a failure, 2 for bad input, 130 for Ctrl-C, 141 for a closed pipe.
    """
    try:
        os.getcwd()
    except FileNotFoundError:  # without one, importing torch would end the process
        return complain("the working directory was deleted", 2)
    try:
        work()
        if sys.stdout:  # None where it was closed
            sys.stdout.flush()
    except InputError as error:
        return complain(str(error), 2)
    except ImportError as error:
        return complain(missing_extra(error), 2)
    except BrokenPipeError:  # the reader has read enough, as `head` does
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 128 + signal.SIGPIPE
    except OSError as error:
        return complain(str(error), 2 if error.errno in _BAD_PATH else 1)
    except RunError as error:
        return complain(str(error), 1)
    except MemoryError:
        return complain("there is not enough memory", 1)
    except Interrupted:
        return complain("stopped; the same command continues from here", 130)
    except KeyboardInterrupt:
        return complain("stopped", 130)
    return 0


def complain(sentence: str, status: int) -> int:
    """Prints a sentence about a failure on stderr; returns `status`."""
    notice(sentence)
    return status
