"""OpenGL pictures of a MuJoCo model without a display, through EGL.

`mujoco.Renderer` draws with whatever MUJOCO_GL said when MuJoCo was first imported, and where
that is EGL and there is none, the import itself fails. The canvas here asks for EGL when it is
made: its absence is one sentence, and it works in any process, whatever was imported before.
"""

from __future__ import annotations

import json
import sys
import time

import mujoco
import numpy as np

from ..errors import EGL_REMEDY, InputError


class Canvas:
    """Draws a model with one of its cameras.

    Attributes:
      renderer: the name OpenGL gives itself: "llvmpipe" is a processor at work, not a graphics
        card.
      scene: MuJoCo's; geoms may be added to it between `look` and `pixels`.
    """

    def __init__(
        self, model: mujoco.MjModel, camera: str, width: int, height: int, max_geoms: int = 4000
    ) -> None:
        """Opens EGL.

        Args:
          model: what to draw.
          camera: the name of the model's camera to look through.
          width: of a picture, in pixels, at most the model's `offwidth`.
          height: of a picture, in pixels, at most the model's `offheight`.
          max_geoms: in the scene.

        Raises:
          InputError: there is no EGL.
        """
        self._model = model
        self._camera = mujoco.MjvCamera()
        self._camera.type = mujoco.mjtCamera.mjCAMERA_FIXED.value
        self._camera.fixedcamid = model.camera(camera).id
        self._options = mujoco.MjvOption()
        self._options.flags[mujoco.mjtVisFlag.mjVIS_RANGEFINDER] = False
        self._rectangle = mujoco.MjrRect(0, 0, width, height)
        self._pixels = np.empty((height, width, 3), dtype=np.uint8)
        try:
            from mujoco.egl import GLContext

            self._gl = GLContext(width, height)
            self._gl.make_current()
            # Only now, when PyOpenGL knows that its platform is EGL.
            from OpenGL.GL import GL_RENDERER, glGetString

            self.renderer = str(glGetString(GL_RENDERER).decode())  # type: ignore[union-attr]
            self.scene = mujoco.MjvScene(model, max_geoms)
            self._context = mujoco.MjrContext(model, mujoco.mjtFontScale.mjFONTSCALE_100.value)
        except Exception as error:  # whatever a driver, PyOpenGL or MuJoCo make of its absence
            reason = " ".join(str(error).split())
            raise InputError(
                f"there is no headless OpenGL (EGL) on this machine; get it with `{EGL_REMEDY}` "
                f"({reason})"
            ) from error
        mujoco.mjr_setBuffer(mujoco.mjtFramebuffer.mjFB_OFFSCREEN.value, self._context)

    def look(self, data: mujoco.MjData) -> None:
        """Makes the scene what the camera sees in `data`."""
        category = mujoco.mjtCatBit.mjCAT_ALL.value
        mujoco.mjv_updateScene(
            self._model, data, self._options, None, self._camera, category, self.scene
        )

    def pixels(self) -> np.ndarray:
        """Draws the scene: colours, shape (height, width, 3); valid until the next call."""
        mujoco.mjr_render(self._rectangle, self.scene, self._context)
        mujoco.mjr_readPixels(self._pixels, None, self._rectangle, self._context)
        return self._pixels[::-1]  # OpenGL's first row is the lowest

    def close(self) -> None:
        """Frees what OpenGL holds; the canvas is of no use any more."""
        self._context.free()
        self._gl.free()


def probe(frames: int = 5) -> None:
    """Prints, as JSON, what renders here and the milliseconds of a 640 x 480 picture."""
    from ...models import arena_spec

    model = arena_spec().compile()
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    canvas = Canvas(model, "overhead", 640, 480)
    times = []
    for _ in range(1 + frames):
        began = time.perf_counter()
        canvas.look(data)
        canvas.pixels()
        times.append(time.perf_counter() - began)
    canvas.close()
    # The first picture compiles shaders and says nothing of the others.
    print(json.dumps({"renderer": canvas.renderer, "ms": 1e3 * sorted(times[1:])[frames // 2]}))


if __name__ == "__main__":
    try:
        probe()
    except InputError as error:
        sys.exit(str(error))
