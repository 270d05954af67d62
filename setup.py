"""Lists the packages, and makes README's links absolute; pyproject.toml has the rest of the build.

Setuptools finds packages by itself only if their folder has their name. The root folder of this
repository, which is the package `musebot`, can have any name.
"""

import re
import tomllib
from pathlib import Path

from setuptools import find_packages, setup

ROOT = Path(__file__).resolve().parent
REPOSITORY = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["urls"]["Repository"]


def absolute(match: re.Match) -> str:
    """Returns a relative link or picture of README with an absolute address."""
    before, target = match.groups()
    kind = "raw" if target.endswith((".gif", ".png", ".svg")) else "blob"
    return f"{before}{REPOSITORY}/{kind}/main/{target}"


README = (ROOT / "README.md").read_text()

setup(
    packages=["musebot", *(f"musebot.{name}" for name in find_packages(exclude=["tests*"]))],
    long_description=re.sub(r'(\]\(|src=")(?!https?:|#)([^)"]+)', absolute, README),
    long_description_content_type="text/markdown",
    script_name="setup.py",  # leaves this file out of the package
)
