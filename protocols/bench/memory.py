"""The peak memory of a process that simulates robots."""

from __future__ import annotations

import multiprocessing
import resource
import signal
import sys
import tempfile
from multiprocessing.connection import Connection
from pathlib import Path

from ..errors import RunError
from ..lives.worker import DIED, prepare_process
from ..storage import save_arrays
from .lives import Setting, begin_training, new_cohort


def peak_memory(setting: Setting) -> float:
    """Measures the memory of a new process that simulates a block and saves a checkpoint.

    Returns:
      Peak memory in MB of 10^6 bytes.

    Raises:
      RunError: The process died.
    """
    context = multiprocessing.get_context("spawn")
    near, far = context.Pipe(duplex=False)
    process = context.Process(target=_send_peak, args=(far, setting), daemon=True)
    process.start()
    far.close()
    try:
        return near.recv()
    except EOFError as error:
        raise RunError(DIED) from error
    finally:
        process.terminate()  # after Ctrl-C it may still be at work
        process.join()


def _send_peak(pipe: Connection, setting: Setting) -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the parent ends this process
    prepare_process()
    cohort = new_cohort(setting)
    cohort.advance(1)  # the first step of a test
    begin_training(cohort, setting.task)
    cohort.advance(setting.steps)
    arrays, notes = cohort.checkpoint()
    with tempfile.TemporaryDirectory() as folder:
        save_arrays(Path(folder) / "checkpoint.safetensors", arrays, **notes)
    pipe.send(peak_bytes() / 1e6)


def peak_bytes() -> int:
    """Returns the peak memory of this process in bytes."""
    # Linux passes ru_maxrss on from the process that started this one; VmHWM is our own.
    status = Path("/proc/self/status")
    if status.exists():
        for line in status.read_text().splitlines():
            if line.startswith("VmHWM:"):
                return int(line.split()[1]) * 1024
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return peak if sys.platform == "darwin" else peak * 1024
