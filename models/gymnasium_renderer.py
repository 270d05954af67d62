"""Gymnasium's renderer of the arena. Imported only for the first picture: it loads GLFW."""

from __future__ import annotations

import atexit
import weakref
from typing import Any

import glfw
import mujoco
from gymnasium.envs.mujoco.mujoco_rendering import MujocoRenderer

from .rendering import check_process, choose_backend, fit_buffer, leave_egl


class ArenaRenderer(MujocoRenderer):
    """Gymnasium's `MujocoRenderer` in a process where other code opens OpenGL contexts, too."""

    def __init__(
        self, model: mujoco.MjModel, data: mujoco.MjData, camera_id: str, width: int, height: int
    ) -> None:
        """Prepares pictures of `width` x `height` pixels; enlarges the model's buffer to fit them.

        `camera_id` is the name of a camera; a window starts with its view.
        """
        fit_buffer(model, width, height)
        super().__init__(
            model,
            data,
            default_cam_config={
                "type": int(mujoco.mjtCamera.mjCAMERA_FIXED),
                "fixedcamid": model.camera(camera_id).id,
            },
            width=width,
            height=height,
            camera_name=camera_id,
            visual_options={int(mujoco.mjtVisFlag.mjVIS_RANGEFINDER): False},
        )

        self._free = weakref.finalize(self, _free, self._viewers)
        self._free.atexit = False  # else it would run after the display's end

    def render(self, render_mode: str | None) -> Any:
        """Draws the window, or returns a picture; see Gymnasium's `MujocoRenderer`."""
        if render_mode != "human":
            choose_backend()
            picture = super().render(render_mode)
            leave_egl()
            return picture
        check_process()
        leave_egl()
        super().render(render_mode)
        # EGL refuses a thread with a current window context.
        glfw.make_context_current(None)  # type: ignore[arg-type]

    def _get_viewer(self, render_mode: str | None) -> Any:
        viewer = super()._get_viewer(render_mode)
        # For an environment that nobody closes. Exit handlers run in reverse order: this one before
        # the display's, which the display's first context has just registered.
        atexit.unregister(self._free)
        atexit.register(self._free)
        viewer.make_context_current()  # Gymnasium does so only with several viewers of its own
        return viewer

    def close(self) -> None:
        """Closes the window, and frees the OpenGL contexts."""
        self._free()
        atexit.unregister(self._free)


def _free(viewers: dict[str, Any]) -> None:
    # Gymnasium's own method also stops GLFW, which destroys the contexts of all other code.
    for mode, viewer in viewers.items():
        if mode == "human":
            leave_egl()
        viewer.make_context_current()
        viewer.con.free()
        viewer.free()
    viewers.clear()
