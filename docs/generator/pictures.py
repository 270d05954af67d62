"""Makes the films and pictures of the tasks anew: `make pictures`."""

from __future__ import annotations

import ast
import hashlib
import json
import subprocess
import sys
from pathlib import Path
from xml.etree import ElementTree

from PIL import Image

import musebot
from musebot.tasks.arena import SUITE

ROOT = Path(__file__).parents[2]
IMAGES = ROOT / "docs" / "images"
MADE = IMAGES / "made.json"  # the digest of what the pictures were made of

# The picture of a task: seed of the start, and camera.
STILLS = {
    "wall_avoidance": (5, "corner"),
    "spot_finding": (5, "corner"),
    "wall_avoidance_obstacles": (6, "corner"),
    "spot_finding_two_noses": (3, "follow"),
    "spot_finding_walls": (7, "corner"),
    "spot_finding_jumping": (5, "overhead"),
}
STEADY = "film docs/results/steady --task spot_finding --proposer creative --robot 8 --phase both"
# The words of `musebot` that make a file, without `--output FILE`.
COMMANDS = {
    "before-after.gif": f"{STEADY} --seconds 6 --speed 50",
    **{f"{task}.gif": f"film --task {task} --phase both --seed 1 --seconds 8" for task in SUITE},
}


def digest() -> str:
    """Returns the digest of the files that decide what pictures show, without comments."""
    code = [ROOT / "protocols" / "pages" / f"{name}.py" for name in ("film", "panel", "scene")]
    code += [ROOT / "models" / "arena_variants.py", Path(__file__)]
    models = sorted((ROOT / "models").glob("*.xml"))
    content = [ElementTree.canonicalize(from_file=str(path)) for path in models]
    content += [_without_docstrings(path.read_text()) for path in sorted(code)]
    return hashlib.sha256("".join(content).encode()).hexdigest()


def _without_docstrings(code: str) -> str:
    tree = ast.parse(code)
    for node in ast.walk(tree):
        documented = isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef)
        if documented and ast.get_docstring(node):
            node.body[0] = ast.Pass()
    return ast.unparse(tree)


def main() -> None:
    """Makes all files in docs/images, and writes the digest."""
    for name, words in COMMANDS.items():
        command = [sys.executable, "-m", "musebot", *words.split(), "--output", IMAGES / name]
        subprocess.run(command, cwd=ROOT, check=True)
    for task, (seed, camera) in STILLS.items():
        environment = musebot.load("arena", task, task_kwargs={"random": seed})
        environment.reset()
        large = environment.physics.render(720, 1080, camera_id=camera)
        small = Image.fromarray(large).resize((360, 240), Image.Resampling.BOX)
        small.save(IMAGES / f"{task}.png")
    MADE.write_text(json.dumps({"digest": digest()}) + "\n")


if __name__ == "__main__":
    main()
