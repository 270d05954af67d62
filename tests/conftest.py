"""Settings of all tests."""

import os

# Nothing here draws in this process, and without a display looking for OpenGL warns.
os.environ.setdefault("MUJOCO_GL", "off")
