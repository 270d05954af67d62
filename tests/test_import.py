"""Importing musebot is light, and changes nothing; more is imported when it is asked for."""

import json
import subprocess
import sys

# Each part prints which packages are loaded after it: heavy ones, and those of musebot.
SEEN = """
import json, os, sys
environment = dict(os.environ)
heavy = "torch OpenGL mujoco dm_control matplotlib scipy rich".split()
def seen():
    ours = {name.split(".")[1] for name in sys.modules if name.startswith("musebot.")}
    print(json.dumps([[name for name in heavy if name in sys.modules], sorted(ours)]))
import musebot
seen()
"""
CONTROLLER = (
    f"{SEEN}\nmusebot.controller\nseen()\n"
    + """
changed = {name for name, _ in dict(os.environ).items() ^ environment.items()}
assert changed <= {"PYGAME_HIDE_SUPPORT_PROMPT"}, changed  # Gymnasium sets it
"""
)
LOAD = (
    f"{SEEN}\nmusebot.load('arena', 'wall_avoidance').reset()\nseen()\n"
    + """
for name in ("controller", "models", "protocols", "tasks"):
    assert getattr(musebot, name).__name__ == f"musebot.{name}"
"""
)


def seen(code, cwd):
    # Elsewhere, so that no module of the tests' folder is imported instead of one of musebot's.
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, cwd=cwd)
    assert done.returncode == 0, done.stderr
    assert list(cwd.iterdir()) == []
    return [json.loads(line) for line in done.stdout.splitlines()]


def test_import_is_light_and_that_of_the_controller_too(tmp_path):
    before, after = seen(CONTROLLER, tmp_path)
    assert before == [[], ["extras", "gymnasium_registration"]]
    assert after == [[], ["controller", "extras", "fields", "gymnasium_registration"]]


def test_the_first_load_imports_neither_brains_nor_commands(tmp_path):
    _, (heavy, ours) = seen(LOAD, tmp_path)
    assert not {"torch", "matplotlib", "rich"} & {*heavy}
    assert not {"protocols", "controller"} & {*ours}
