"""Runs a hostile case within limits, and checks what it did."""

import collections
import contextlib
import hashlib
import io
import os
import resource
import signal
import stat
import traceback

REFUSED = {1, 2}  # exit statuses of a refusal
# Of a case: processor time, time on a busy machine, and address space that it may add.
MOST_SECONDS, LONGEST_WAIT, MOST_BYTES = 10.0, 120.0, 2**31
MOST_CHARACTERS = 4500  # of the sentence of a refusal: 2,000 with every character escaped


def one(draw, values):
    """Draws one of several values, by a random generator."""
    return values[draw.integers(len(values))]


class OutOfTime(BaseException):
    """A case ran longer than it may."""


Outcome = collections.namedtuple("Outcome", "status value printed")
"""What a case did: its exit status, or "traceback", "slow" or "memory" for what must not happen;
what its work returned; and its text on stderr."""


@contextlib.contextmanager
def limited():
    """Bounds the time and the memory of what happens in this context."""

    def late(number, frame):
        raise OutOfTime

    soft, hard = resource.getrlimit(resource.RLIMIT_AS)
    with open("/proc/self/statm") as file:
        pages = int(file.read().split()[0])
    timers = (
        (signal.ITIMER_PROF, signal.SIGPROF, MOST_SECONDS),
        (signal.ITIMER_REAL, signal.SIGALRM, LONGEST_WAIT),
    )
    before = [signal.signal(number, late) for _, number, _ in timers]
    for timer, _, seconds in timers:
        signal.setitimer(timer, seconds)
    resource.setrlimit(resource.RLIMIT_AS, (pages * resource.getpagesize() + MOST_BYTES, hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_AS, (soft, hard))
        for (timer, number, _), handler in zip(timers, before, strict=True):
            signal.setitimer(timer, 0)
            signal.signal(number, handler)


def carried_out(work):
    """Does work, which returns an exit status and a value, as a command would; its outcome."""
    err, value = io.StringIO(), None
    with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(err):
        try:
            with limited():
                status, value = work()
        except SystemExit as end:
            status = end.code or 0
        except OutOfTime:
            status = "slow"
        except MemoryError:
            status = "memory"
        except BaseException:
            status = "traceback"
            err.write(traceback.format_exc())
    printed = err.getvalue()
    if status == 1 and "not enough memory" in printed:
        status = "memory"
    return Outcome(status, value, printed)


def complaint(outcome):
    """Returns what is wrong with an outcome that must be a refusal; empty if nothing is."""
    if outcome.status not in REFUSED:
        return f"status {outcome.status}: {outcome.printed[-1500:]}"
    lines = outcome.printed.strip().splitlines()
    if "Traceback" in outcome.printed:
        return f"traceback: {outcome.printed[-1500:]}"
    # Warnings may come before it; the last line is the refusal.
    if not lines or not lines[-1].startswith("musebot: ") or len(lines[-1]) > MOST_CHARACTERS:
        return f"no sentence: {outcome.printed[-1500:]!r}"
    if any(ord(letter) < 32 or ord(letter) == 127 for letter in lines[-1]):
        return f"control characters: {lines[-1]!r}"
    if [line for line in lines[:-1] if not line.startswith("musebot: ")]:
        return f"several lines: {outcome.printed[-1500:]!r}"
    return ""


def snapshot(*folders, contents=True):
    """Returns names, kinds, sizes and contents of all below some folders, links not followed.

    Without contents, the times of the last change stand for them.
    """
    found = {}
    for folder in folders:
        stack = [os.fsencode(folder)]
        while stack:
            path = stack.pop()
            try:
                state = os.lstat(path)
            except FileNotFoundError:
                found[path] = None
                continue
            kind, content = stat.S_IFMT(state.st_mode), state.st_size
            if stat.S_ISDIR(kind):
                stack += [entry.path for entry in os.scandir(path)]
                content = None
            elif stat.S_ISLNK(kind):
                content = os.readlink(path)
            elif not contents:
                content = state.st_mtime_ns, state.st_size
            elif stat.S_ISREG(kind) and state.st_size < 2**22:
                with open(path, "rb") as file:
                    content = hashlib.blake2b(file.read(), digest_size=16).digest()
            found[path] = kind, stat.S_IMODE(state.st_mode), content
    return found
