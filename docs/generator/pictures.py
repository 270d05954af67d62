"""Makes the films and pictures of the tasks anew: `make pictures`."""

from __future__ import annotations

import hashlib
import json
import subprocess
import sys
from pathlib import Path

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
STEADY = "film docs/results/steady --task spot_finding --proposer creative --robot 3 --phase both"
# The words of `musebot` that make a file, without `--output FILE`.
COMMANDS = {
    "before-after.gif": f"{STEADY} --seconds 6 --speed 50",
    **{f"{task}.gif": f"film --task {task} --phase both --seed 1 --seconds 8" for task in SUITE},
}


def digest() -> str:
    """Returns the digest of the files that decide what the pictures show."""
    sources = [*(ROOT / "models").glob("*.xml"), ROOT / "models" / "arena_variants.py"]
    sources += [ROOT / "protocols" / "pages" / f"{name}.py" for name in ("film", "panel", "scene")]
    sources += [Path(__file__)]
    content = b"".join(path.read_bytes() for path in sorted(sources))
    return hashlib.sha256(content).hexdigest()


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
