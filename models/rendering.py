"""OpenGL for pictures of the arena: the backend, the context and the size of the largest picture.

MUJOCO_GL is the user's choice of a backend. If it is unset and there is no display, the first
picture sets it to EGL. The choice waits for the first picture, because EGL takes time to start.
"""

from __future__ import annotations

import contextlib
import functools
import importlib
import os
import sys
import threading
import warnings
from collections.abc import Iterator
from typing import Any

import mujoco

from ..extras import EGL_REMEDY

_drew = False  # whether musebot opened OpenGL here, or in a process from which this one was forked
_forked = False  # whether this process was forked after any code opened OpenGL


def _note_fork() -> None:
    global _forked
    mujoco_egl, suite = map(sys.modules.get, ("mujoco.egl", "dm_control._render.base"))
    others = getattr(mujoco_egl, "EGL_DISPLAY", None) or getattr(
        suite, "_CURRENT_THREAD_FOR_CONTEXT", None
    )
    _forked = _forked or _drew or bool(others)


if hasattr(os, "register_at_fork"):  # not on Windows
    os.register_at_fork(after_in_child=_note_fork)


def check_process() -> None:
    """Raises RuntimeError in a process that was forked after OpenGL was opened.

    Drawing a picture would never end there.
    """
    if _forked:
        raise RuntimeError(
            "OpenGL cannot be used in a process that was forked after a picture was drawn: start "
            "processes with the context 'spawn', or draw the first picture after the fork"
        )


def load_triton() -> None:
    """Imports Triton, if it is installed, before EGL is opened.

    CUDA builds of torch import it for torch._dynamo. The import crashes where Mesa's EGL was opened
    first, because Triton and Mesa both contain LLVM.
    """
    with contextlib.suppress(Exception):  # whatever is wrong with it, pictures do not need it
        importlib.import_module("triton")


if os.environ.get("MUJOCO_GL") == "egl":  # then the import of dm_control opens EGL
    load_triton()
try:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # dm_control looks for a display; GLFW warns of its absence
        from dm_control import _render
        from dm_control._render import base
except ModuleNotFoundError as error:
    if error.name != "dm_control":
        raise
    raise ModuleNotFoundError(
        "dm_control is not installed; on Python 3.13 and later, where its requirement labmaze "
        "cannot be built, pip install --no-deps dm-control==1.0.50 gets it",
        name=error.name,
    ) from error

DRAWS_NOTHING = ("off", "disable", "disabled", "false", "0")  # values of MUJOCO_GL


def has_display() -> bool:
    """Returns whether there is a display, which may still not answer."""
    return sys.platform != "linux" or any(map(os.environ.get, ("DISPLAY", "WAYLAND_DISPLAY")))


def no_window() -> str:
    """Returns why no window can be opened, in half a sentence; "" if one can be opened."""
    if not has_display():
        return "there is no display to open a window on"
    try:
        import glfw

        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # the returned text says it
            ready = glfw.init()
    except Exception as error:  # no library, or a display that does not answer
        return f"GLFW cannot open a window here ({error})"
    return "" if ready else "GLFW cannot open a window on this display"


def choose_backend() -> str:
    """Returns MUJOCO_GL in lower case, after setting it to "egl" if it is unset without a display.

    "" means the default backend of a machine with a display. Raises RuntimeError where the backend
    draws nothing or cannot be opened, or the process was forked after OpenGL was opened.
    """
    global _drew
    check_process()
    backend = _chosen_backend()
    _drew = True
    return backend


def _chosen_backend() -> str:
    chosen = os.environ.get("MUJOCO_GL", "")
    backend = chosen.lower()
    if backend in DRAWS_NOTHING:
        raise RuntimeError(f"MUJOCO_GL is {chosen!r}, with which nothing is drawn: unset it")
    if backend == "egl":
        _egl_context()
    if backend in ("egl", "osmesa") or sys.platform != "linux" or not (reason := no_window()):
        return backend
    if chosen:
        raise RuntimeError(f"MUJOCO_GL is {chosen!r}, but {reason}: unset it, or set it to 'egl'")
    _egl_context()
    os.environ["MUJOCO_GL"] = "egl"
    return "egl"


def open_context(width: int, height: int) -> Any:
    """Opens dm_control's OpenGL context for pictures of at most `width` x `height` pixels."""
    # dm_control chose a backend when it was imported; MUJOCO_GL may have been set since.
    is_egl = choose_backend() == "egl"
    renderer = _egl_context() if is_egl else _render.Renderer
    if _render.BACKEND == "glfw":
        no_window()  # initialises GLFW again after Gymnasium has closed a window
    if not isinstance(renderer, type):
        raise RuntimeError("dm_control was imported without OpenGL: set MUJOCO_GL to 'egl'")
    shared: Any = type("Context", (_Shared, renderer), {"_is_egl": is_egl})
    return shared(width, height)


class _Shared:
    """A dm_control context for a process in which other code opens OpenGL contexts, too.

    dm_control only remembers which of its own contexts is current, and in which thread. A context
    of EGL is released after each picture, so that the next may be drawn in any thread.
    """

    _is_egl: bool

    @contextlib.contextmanager
    def make_current(self) -> Iterator[Any]:
        with super().make_current() as executor:  # type: ignore[misc]
            executor.call(self._platform_make_current)  # type: ignore[attr-defined]
            try:
                yield executor
            finally:
                if self._is_egl:
                    leave_egl()
                    base._CURRENT_CONTEXT_FOR_THREAD.pop(threading.current_thread(), None)
                    base._CURRENT_THREAD_FOR_CONTEXT.pop(id(self), None)


@functools.cache
def _egl_context() -> type:
    load_triton()
    try:
        from dm_control._render.pyopengl.egl_renderer import EGLContext
        from mujoco.egl import GLContext

        # Gymnasium's contexts are of this class. The first context registers the exit handler of
        # the display that all contexts share. Registered first, the handler runs last.
        GLContext(1, 1).free()
    except Exception as error:  # drivers and PyOpenGL each raise their own kinds
        raise RuntimeError(no_egl(error)) from error
    return EGLContext


def no_egl(error: Exception) -> str:
    """Returns a sentence about a failure to open EGL, with the command that installs it."""
    reason = " ".join(str(error).split())
    return (
        f"there is no headless OpenGL (EGL) on this machine; get it with `{EGL_REMEDY}` ({reason})"
    )


def leave_egl() -> None:
    """Releases this thread's EGL context, so that another thread may draw with it.

    X11 stops a process that makes a window's context current before this release.
    """
    if egl := sys.modules.get("OpenGL.EGL"):
        egl.eglReleaseThread()


def fit_buffer(model: mujoco.MjModel, width: int, height: int) -> bool:
    """Enlarges a model's picture buffer to a size in pixels; returns whether it was too small."""
    size = model.vis.global_
    if width <= size.offwidth and height <= size.offheight:
        return False
    size.offwidth = max(width, size.offwidth)
    size.offheight = max(height, size.offheight)
    return True
