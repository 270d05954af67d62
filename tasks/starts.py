"""SHIM."""

from .arena import CORNERS, FROM_WALLS, Start, random_poses, random_spots  # noqa: F401
