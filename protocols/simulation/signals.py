"""Ctrl-C and SIGTERM as a request to stop, which a simulation meets at its next checkpoint."""

from __future__ import annotations

import contextlib
import signal
import threading
from collections.abc import Iterator
from typing import Any


class StopRequest:
    """A request to stop, set by signals.

    A handler only sets a plain flag: an Event has a lock that the interrupted thread may hold.

    Attributes:
      stop: Whether Ctrl-C or SIGTERM has asked to stop.
    """

    stop = False


@contextlib.contextmanager
def stop_on_signals() -> Iterator[StopRequest]:
    """Turns Ctrl-C and SIGTERM into a request to stop; only the main thread has signals."""
    request = StopRequest()
    if threading.current_thread() is not threading.main_thread():
        yield request
        return

    def handler(number: int, frame: Any) -> None:
        del number, frame
        request.stop = True

    before = {number: signal.signal(number, handler) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield request
    finally:
        for number, old in before.items():
            signal.signal(number, old)
