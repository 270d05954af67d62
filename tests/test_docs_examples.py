"""The examples and the tutorial run: all in one process, each with names of its own."""

import json
import os
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

DOCS = Path(__file__).parents[1] / "docs"

# What is checked behind each example of a page, where its names are still known.
CHECKS = {
    "command": ["assert run.experiment.brain.ideas == 9 and len(run.robots(condition)) == 2"],
    "faq": ["assert abs(left) <= 0.5 and abs(right) <= 0.5"],
    "methods": ["assert run.curves(creative).shape == (500, 360) and robot.agent()"],
    "results": ["assert f'{post.mean() / steps:.1%}' == '14.6%'  # README's last row"],
    "install": ["assert picture.shape == (240, 360, 3) and frame.shape == (320, 480, 3)"],
    "tasks": [
        "assert total > 150",  # the policies in the examples earn something
        "assert total > 150",
        "from pathlib import Path; assert Path('driver.zip').exists()",
        "assert earned.shape == (64,) and all(earned >= 0)",
    ],
    "own": [
        None,  # tests/tasks/test_own_tasks.py runs the first two
        None,
        "x, y, heading = env.physics.robot_pose()\n"
        "assert abs(x + 0.35 + 0.0275) < 1e-3 and abs(y + 0.2) < 2e-3 and abs(heading) < 0.05",
        "x = [data.body(f'{name}_robot').xpos[0] for name in 'ab']\n"
        "assert abs(x[0] - (0.28 - 0.0275)) < 1e-3 and abs(x[1]) < 1e-6\n"
        "assert data.sensor('a_touch').data[0] > 0",
    ],
}
# What takes long is shortened.
SHORTER = {
    "learn(327_680)": "learn(1)",
    "n_steps=256": "n_steps=8",
    "batch_size=2048": "batch_size=512",
    "64, threads=2": "64, max_episode_steps=5",
    "range(1000):\n    motors = policy": "range(20):\n    motors = policy",
}
RUN = """
import contextlib, io, json, multiprocessing, sys, traceback
fork = multiprocessing.get_context("fork")
multiprocessing.get_context = lambda method=None: fork  # new ones import PyTorch for seconds
printed, failed = {}, {}
for name, code in json.load(sys.stdin):
    try:
        with contextlib.redirect_stdout(io.StringIO()) as out:
            exec(code, {"__name__": "example"})
        printed[name] = out.getvalue()
    except Exception:
        failed[name] = traceback.format_exc()
json.dump([printed, failed], open("seen.json", "w"))
"""


def examples():
    """Returns the examples by page and number, with their checks."""
    found = {}
    for page, checks in CHECKS.items():
        blocks = re.findall(r"```python\n(.*?)```", (DOCS / f"{page}.md").read_text(), re.DOTALL)
        for number, (block, check) in enumerate(zip(blocks, checks, strict=True)):
            if check is not None:
                found[f"{page} {number}"] = f"{block}{check}\n"
    for long, short in SHORTER.items():
        assert sum(long in code for code in found.values()) == 1, long
        found = {name: code.replace(long, short) for name, code in found.items()}
    fixed = found["own 3"].partition("x = [")[0].replace("# robot.delete", "robot.delete")
    found["own without a joint"] = f"{fixed}assert data.body('a_robot').xpos[0] == 0\n"
    return found


def tutorial():
    """Returns the code of the tutorial, and what its page says that it prints."""
    page = (DOCS / "tutorial.md").read_text()
    parts = (re.findall(rf"```{kind}\n(.*?)```", page, re.DOTALL) for kind in ("python", "text"))
    return tuple("".join(part) for part in parts)


@pytest.mark.slow
def test_the_examples_and_the_tutorial_run_and_print_what_the_documents_hold(tmp_path, egl):
    for module, extra in (("gymnasium", "gym"), ("stable_baselines3", "baselines")):
        pytest.importorskip(module, reason=f"needs the extra `{extra}`")
    (tmp_path / "docs").symlink_to(DOCS)
    lesson, kept = tutorial()
    code = [*examples().items(), ("tutorial", lesson)]
    environment = {k: v for k, v in os.environ.items() if k not in ("MUJOCO_GL", "DISPLAY")}
    done = subprocess.run(
        [sys.executable, "-c", RUN], input=json.dumps(code), cwd=tmp_path,
        env=environment | {"MPLBACKEND": "Agg"}, capture_output=True, text=True,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    printed, failed = json.loads((tmp_path / "seen.json").read_text())
    assert not failed, "\n".join(f"{name}:\n{error}" for name, error in failed.items())
    assert "ep_rew_mean" in printed["tasks 2"]
    number = re.compile(r"-?\d+(\.\d+)?")  # numbers may differ from machine to machine
    assert number.sub("0", kept).split() == number.sub("0", printed["tutorial"]).split()
    kept = {path.name: path for path in (DOCS / "images").glob("tutorial*.*")}
    assert {path.name for path in tmp_path.glob("tutorial*.*")} == kept.keys()
    for name, path in kept.items():  # of the film, its first picture
        ours, theirs = (np.asarray(Image.open(one), float) for one in (tmp_path / name, path))
        assert ours.shape == theirs.shape
        assert np.abs(ours - theirs).mean() < 3  # of 255; another renderer draws other edges
