"""Set-up of a process that runs jobs: one thread, no OpenGL, an end with its parent."""

from __future__ import annotations

import contextlib
import multiprocessing
import os
import sys
import threading
from collections.abc import Iterator

import torch

from ...tasks.batch import silence_warnings, stop_timers
from ..errors import RunError

DIED = "a process died, perhaps for want of memory"


def prepare_process() -> None:
    """Gives this process one torch thread, no MuJoCo timers and no MuJoCo log."""
    torch.set_num_threads(1)
    stop_timers()
    silence_warnings()


@contextlib.contextmanager
def single_threaded_children() -> Iterator[None]:
    """Makes processes that start in this context have one thread and no OpenGL.

    Several threads only slow down tensors as small as these, and nothing is drawn.
    """
    settings = {"OMP_NUM_THREADS": "1", "MKL_NUM_THREADS": "1", "MUJOCO_GL": "off"}
    before = {name: os.environ.get(name) for name in settings}
    os.environ.update(settings)
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                os.environ.pop(name, None)
            else:
                os.environ[name] = value


@contextlib.contextmanager
def children_without_script() -> Iterator[None]:
    """Makes processes that start in this context not import the main module.

    Python imports it in every process that it spawns, where a script without the usual guard would
    simulate again. Jobs need nothing of it.
    """
    main = sys.modules["__main__"]
    hidden = {name: vars(main)[name] for name in ("__spec__", "__file__") if name in vars(main)}
    main.__spec__ = None
    vars(main).pop("__file__", None)
    try:
        yield
    finally:
        vars(main).update(hidden)


def follow_parent() -> None:
    """Ends this process as soon as the one that started it ends."""

    def follow() -> None:
        if (parent := multiprocessing.parent_process()) is not None:
            parent.join()
            os._exit(1)

    threading.Thread(target=follow, daemon=True).start()


def stopped_by(error: Exception) -> RunError:
    """Returns the error that says in one sentence what stopped a simulation."""
    what = f"a file could not be read or written ({error})" if isinstance(error, OSError) else DIED
    return RunError(f"{what}; the same command continues from the last checkpoints")
