"""Ctrl-C and SIGTERM as a request to stop, which a simulation meets at its next checkpoint."""

from __future__ import annotations

import contextlib
import signal
import threading
from collections.abc import Callable, Iterator


class StopRequest:
    """A request to stop, set by signals.

    A handler only sets a plain flag: an Event has a lock that the interrupted thread may hold.

    Attributes:
      stop: Whether Ctrl-C or SIGTERM has asked to stop.
    """

    stop = False


@contextlib.contextmanager
def stop_on_signals() -> Iterator[StopRequest]:
    """Turns Ctrl-C and SIGTERM into a request to stop."""
    request = StopRequest()

    def stop(number: int, frame: object) -> None:
        del number, frame
        request.stop = True

    with handling(stop, signal.SIGINT, signal.SIGTERM):
        yield request


@contextlib.contextmanager
def handling(
    handler: Callable[[int, object], None] | signal.Handlers, *numbers: signal.Signals
) -> Iterator[None]:
    """Lets a handler receive signals; only the main thread has them, others change nothing."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before = {number: signal.signal(number, handler) for number in numbers}
    try:
        yield
    finally:
        for number, old in before.items():
            signal.signal(number, old)
