"""Refuses a working directory that was deleted: MuJoCo, GLFW and others could not be imported."""

import os

try:
    os.getcwd()
except FileNotFoundError as error:
    raise FileNotFoundError(
        "the working directory does not exist any more: change to one that does"
    ) from error
