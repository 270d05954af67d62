"""The build includes every module and every data file."""

import tomllib
from pathlib import Path

import pytest

import musebot

ROOT = Path(musebot.__file__).parent
FOLDERS = [ROOT / name for name in ("models", "tasks", "controller", "protocols")]
FILES = [
    path
    for folder in FOLDERS
    for path in folder.rglob("*")
    if path.is_file() and "__pycache__" not in path.parts
]


@pytest.mark.skipif(not (ROOT / "setup.py").exists(), reason="needs the sources")
def test_every_folder_with_modules_is_a_package_that_setup_finds():
    from setuptools import find_packages

    found = {ROOT.joinpath(*name.split(".")) for name in find_packages(str(ROOT))}
    assert {path.parent for path in FILES if path.suffix == ".py"} <= found


@pytest.mark.skipif(not (ROOT / "pyproject.toml").exists(), reason="needs the sources")
def test_every_data_file_is_package_data():
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())
    patterns = project["tool"]["setuptools"]["package-data"]
    for path in FILES:
        if path.suffix != ".py":
            folder = next(one for one in path.parents if (one / "__init__.py").exists())
            package = ".".join(("musebot", *folder.relative_to(ROOT).parts))
            assert any(path.match(pattern) for pattern in patterns.get(package, [])), path
