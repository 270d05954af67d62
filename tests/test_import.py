"""Importing musebot is light, and changes nothing."""

import json
import subprocess
import sys

import pytest

LIGHT = """
import json, os, sys, time
environment, began = dict(os.environ), time.process_time()
import musebot
seconds = time.process_time() - began
heavy = ("torch", "OpenGL", "mujoco", "dm_control", "matplotlib")
print(json.dumps({
    "seconds": seconds,
    "loaded": [name for name in heavy if name in sys.modules],
    "environment": dict(os.environ) == environment,
}))
"""

FIRST = """
import time
import musebot
began = time.process_time()
musebot.load("arena", "wall_avoidance").reset()
print(time.process_time() - began)
"""


def python(code, cwd):
    # Elsewhere, so that no module of the tests' folder is imported instead of one of musebot's.
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, cwd=cwd)
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


def test_import_is_light_and_sets_nothing(tmp_path):
    seen = [python(LIGHT, tmp_path) for _ in range(3)]
    assert all(run["loaded"] == [] and run["environment"] for run in seen)
    assert min(run["seconds"] for run in seen) < 0.3  # processor time, whatever else runs
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("name", ["controller", "models", "protocols", "tasks"])
def test_a_package_is_imported_when_it_is_asked_for(name, tmp_path):
    code = f"import json, musebot; print(json.dumps([musebot.{name}.__name__]))"
    assert python(code, tmp_path) == [f"musebot.{name}"]


@pytest.mark.slow
def test_the_first_load_is_quick(tmp_path):
    assert min(python(FIRST, tmp_path) for _ in range(3)) < 1.5
    assert list(tmp_path.iterdir()) == []
