"""Images of a MuJoCo model rendered by OpenGL without a display, through EGL.

`mujoco.Renderer` uses the backend that MUJOCO_GL named when MuJoCo was first imported. If
MUJOCO_GL names EGL and EGL is not installed, that import fails. The canvas here opens EGL only
when it is created. It therefore works in any process, and reports a missing EGL in one sentence.
"""

from __future__ import annotations

import sys

import mujoco
import numpy as np

from ...models import arena_spec
from ...models.rendering import fit_buffer, load_triton, no_egl
from ..errors import InputError

_MOST_GEOMS = 4000  # in the scene


class Canvas:
    """Renders a model through one of its cameras.

    `renderer` is OpenGL's name of the renderer; "llvmpipe" renders on the CPU. Between `look` and
    `pixels`, geoms can be added to MuJoCo's `scene`.
    """

    def __init__(self, model: mujoco.MjModel, camera: str, width: int, height: int) -> None:
        """Opens EGL for images of `width` x `height` pixels by the model's camera `camera`.

        Raises:
          InputError: there is no EGL.
        """
        fit_buffer(model, width, height)
        self._model = model
        self._camera = mujoco.MjvCamera()
        self._camera.type = mujoco.mjtCamera.mjCAMERA_FIXED.value
        self._camera.fixedcamid = model.camera(camera).id
        self._options = mujoco.MjvOption()
        self._options.flags[mujoco.mjtVisFlag.mjVIS_RANGEFINDER] = False
        self._rectangle = mujoco.MjrRect(0, 0, width, height)
        self._pixels = np.empty((height, width, 3), dtype=np.uint8)
        load_triton()
        try:
            from mujoco.egl import GLContext

            self._gl = GLContext(width, height)
            self._gl.make_current()
            # mujoco.egl must choose PyOpenGL's platform before this import.
            from OpenGL.GL import GL_RENDERER, glGetString

            self.renderer = str(glGetString(GL_RENDERER).decode())  # type: ignore[union-attr]
            self.scene = mujoco.MjvScene(model, _MOST_GEOMS)
            self._context = mujoco.MjrContext(model, mujoco.mjtFontScale.mjFONTSCALE_100.value)
        except Exception as error:  # drivers, PyOpenGL and MuJoCo raise various errors
            raise InputError(no_egl(error)) from error
        mujoco.mjr_setBuffer(mujoco.mjtFramebuffer.mjFB_OFFSCREEN.value, self._context)

    def look(self, data: mujoco.MjData) -> None:
        """Updates the scene to the state in `data`, as the camera sees it."""
        category = mujoco.mjtCatBit.mjCAT_ALL.value
        mujoco.mjv_updateScene(
            self._model, data, self._options, None, self._camera, category, self.scene
        )

    def pixels(self) -> np.ndarray:
        """Returns the image, uint8, shape (height, width, 3); the next call overwrites it."""
        mujoco.mjr_render(self._rectangle, self.scene, self._context)
        mujoco.mjr_readPixels(self._pixels, None, self._rectangle, self._context)
        return self._pixels[::-1]  # OpenGL's first row is the lowest

    def close(self) -> None:
        """Frees the resources of OpenGL; the canvas cannot be used afterwards."""
        self._context.free()
        self._gl.free()


def probe() -> None:
    """Renders an image, and prints the name of the renderer."""
    model = arena_spec().compile()
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    canvas = Canvas(model, "overhead", 640, 480)
    canvas.look(data)
    canvas.pixels()
    canvas.close()
    print(canvas.renderer)


if __name__ == "__main__":
    try:
        probe()
    except InputError as error:
        sys.exit(str(error))
