"""The examples and notebooks run: all in one process, each with names of its own."""

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
    "index": ["assert abs(env.physics.robot_pose()[0]) < 0.6"],
    "methods": ["assert run.curves(creative).shape == (500, 360) and robot.agent()"],
    "results": ["assert np.round(means, 2).tolist() == [-0.31, -0.29]  # README's last row"],
    "install": ["assert picture.shape == (240, 360, 3) and frame.shape == (320, 480, 3)"],
    "tasks": [
        "assert total > 150",  # the policies in the examples earn something
        "assert env.reset().first()",
        "assert total > 150",
        "assert total.mean() > 150",
        "from pathlib import Path; assert Path('driver.zip').exists()",
        "assert earned.shape == (64,) and all(earned >= 0)",
        "",  # the pictures are compared in the test
    ],
    "own-robot": [
        "x = [data.body(f'{name}_robot').xpos[0] for name in 'ab']\n"
        "assert abs(x[0] - (0.28 - 0.0275)) < 1e-3 and abs(x[1]) < 1e-6\n"
        "assert data.sensor('a_touch').data[0] > 0",
        "place = physics.bind(robot.find('body', 'robot')).xpos[0]\n"
        "assert 0.15 < place == physics.named.data.qpos['scout/'][0] < 0.2  # a second at 0.2 m/s",
        "ahead, *others = timestep.observation['musebot/distances'].ravel()\n"
        "assert timestep.reward == 1 and 0 <= ahead < 1e-3 and others == [-1, -1, -1]",
        "x, y, heading = env.physics.robot_pose()\n"
        "assert abs(x + 0.35 + 0.0275) < 1e-3 and abs(y + 0.2) < 2e-3 and abs(heading) < 0.05",
        "assert info['position'].shape == (8, 2)",
    ],
}
# What takes long is shortened.
SHORTER = {
    "num_envs=50": "num_envs=4",
    "np.zeros(50)": "np.zeros(4)",
    "learn(327_680)": "learn(1)",
    "n_steps=256": "n_steps=8",
    "batch_size=2048": "batch_size=512",
    "64, threads=2": "64, max_episode_steps=5",
    "range(1000):\n    motors = np.conc": "range(20):\n    motors = np.conc",
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
            found[f"{page} {number}"] = f"{block}{check}\n"
    for long, short in SHORTER.items():
        assert sum(long in code for code in found.values()) == 1, long
        found = {name: code.replace(long, short) for name, code in found.items()}
    fixed = found["own-robot 0"].partition("x = [")[0].replace("# robot.delete", "robot.delete")
    found["own-robot without a joint"] = f"{fixed}assert data.body('a_robot').xpos[0] == 0\n"
    return found


def notebooks():
    """Returns the code and the kept output of the notebooks, by name."""
    found = {}
    for path in (DOCS / "notebooks").glob("*.ipynb"):
        cells = json.loads(path.read_text())["cells"]
        code = ["".join(cell["source"]) for cell in cells if cell["cell_type"] == "code"]
        # Jupyter shows the value of the last line; here it is only made.
        shown = "\nif 'Film' in globals():\n    assert 'gif' in Film('film.gif')._repr_html_()\n"
        outputs = [output for cell in cells for output in cell.get("outputs", [])]
        kept = "".join("".join(o["text"]) for o in outputs if o["output_type"] == "stream")
        found[path.stem] = "\n".join(code) + shown, kept
    return found


@pytest.mark.slow
def test_the_examples_and_notebooks_run_and_print_what_the_documents_hold(tmp_path, egl):
    for module, extra in (("gymnasium", "gym"), ("stable_baselines3", "baselines")):
        pytest.importorskip(module, reason=f"needs the extra `{extra}`")
    (tmp_path / "docs").symlink_to(DOCS)
    books = notebooks()
    code = [*examples().items(), *((name, code) for name, (code, _) in books.items())]
    environment = {k: v for k, v in os.environ.items() if k not in ("MUJOCO_GL", "DISPLAY")}
    done = subprocess.run(
        [sys.executable, "-c", RUN], input=json.dumps(code), cwd=tmp_path,
        env=environment | {"MPLBACKEND": "Agg"}, capture_output=True, text=True,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    printed, failed = json.loads((tmp_path / "seen.json").read_text())
    assert not failed, "\n".join(f"{name}:\n{error}" for name, error in failed.items())
    assert "ep_rew_mean" in printed["tasks 4"]
    number = re.compile(r"-?\d+(\.\d+)?")  # numbers may differ from machine to machine
    for name, (_, kept) in books.items():
        assert kept and number.sub("0", kept).split() == number.sub("0", printed[name]).split()
    kept = {path.name: path for path in (DOCS / "images").glob("*_*.png")}
    assert {path.name for path in tmp_path.glob("*.png")} == kept.keys()
    for name, path in kept.items():  # the pictures of tasks
        ours, theirs = (np.asarray(Image.open(one), float) for one in (tmp_path / name, path))
        assert np.abs(ours - theirs).mean() < 3  # of 255; another renderer draws other edges
