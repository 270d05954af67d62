"""Optional packages that musebot can use, and how to install them."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator

EGL_REMEDY = "apt-get install libegl1 libegl-mesa0 libgl1-mesa-dri"
# Modules that an extra installs (pip install 'musebot[EXTRA]'), by extra; not all are listed.
_MODULES = {
    "baselines": "stable_baselines3",
    "brain": "PIL imageio imageio_ffmpeg jinja2 markdown_it matplotlib rich safetensors scipy "
    "torch",
    "cluster": "ray",
    "gym": "gymnasium moviepy",
    "numba": "numba",
    "tensorboard": "tensorboard",
    "warp": "mujoco_warp warp",
}


def missing_extra(error: ImportError, extra: str = "") -> str:
    """Returns how to install the extra with the missing module, or else the error's own text.

    `extra` names an extra that needs more than this module; "" for the one that has it.
    """
    module = (error.name or "").partition(".")[0]
    for own, modules in _MODULES.items():
        if isinstance(error, ModuleNotFoundError) and module in modules.split():
            return f"{module} is not installed; pip install 'musebot[{extra or own}]' gets it"
    return str(error)


@contextlib.contextmanager
def extra_needed(extra: str = "") -> Iterator[None]:
    """Makes the error of an import name the extra to install; see `missing_extra`.

    Raises:
      ModuleNotFoundError: an import in this context fails.
    """
    try:
        yield
    except ModuleNotFoundError as error:
        raise ModuleNotFoundError(missing_extra(error, extra), name=error.name) from error
