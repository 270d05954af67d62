"""Lists the packages; everything else about the build is in pyproject.toml.

Setuptools finds packages by itself only if their folder has their name. The root folder of this
repository, which is the package `musebot`, can have any name.
"""

from setuptools import find_packages, setup

setup(
    packages=["musebot", *(f"musebot.{name}" for name in find_packages(exclude=["tests*"]))],
    script_name="setup.py",  # leaves this file out of the package
)
