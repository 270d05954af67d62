"""Refuses a deleted working directory, in which MuJoCo, GLFW and others cannot be imported."""

import os

try:
    os.getcwd()
except FileNotFoundError as error:
    raise FileNotFoundError(
        "the working directory does not exist any more: change to one that does"
    ) from error
