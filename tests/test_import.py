"""Importing musebot is light, and changes nothing."""

import json
import subprocess
import sys

import pytest

LIGHT = """
import json, os, sys
environment = dict(os.environ)
import musebot
heavy = ("torch", "OpenGL", "mujoco", "dm_control", "matplotlib", "scipy", "tyro", "rich")
print(json.dumps({
    "ours": sorted(name for name in sys.modules if name.startswith("musebot")),
    "loaded": [name for name in heavy if name in sys.modules],
    "environment": dict(os.environ) == environment,
}))
"""

FIRST = """
import json, sys
import musebot
musebot.load("arena", "wall_avoidance").reset()
heavy = ("torch", "matplotlib", "tyro", "rich", "musebot.protocols", "musebot.controller")
print(json.dumps([name for name in heavy if name in sys.modules]))
"""


def python(code, cwd):
    # Elsewhere, so that no module of the tests' folder is imported instead of one of musebot's.
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, cwd=cwd)
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


def test_import_is_light_and_sets_nothing(tmp_path):
    seen = python(LIGHT, tmp_path)
    assert seen["loaded"] == [] and seen["environment"]
    assert seen["ours"] == ["musebot", "musebot.gymnasium_registration"]
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("name", ["controller", "models", "protocols", "tasks"])
def test_a_package_is_imported_when_it_is_asked_for(name, tmp_path):
    code = f"import json, musebot; print(json.dumps([musebot.{name}.__name__]))"
    assert python(code, tmp_path) == [f"musebot.{name}"]


def test_the_first_load_imports_neither_brains_nor_commands(tmp_path):
    assert python(FIRST, tmp_path) == []
    assert list(tmp_path.iterdir()) == []
