"""docs/tasks.md and the tasks' pages match the code, and the examples run."""

import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

import musebot
from musebot.protocols.cli.film import Film
from musebot.protocols.cli.parser import parsed
from musebot.tasks.arena import CONTROL_TIMESTEP
from musebot.tasks.suite import TASKS

PAGE = Path(__file__).parents[1] / "docs" / "tasks.md"
TEXT = PAGE.read_text()
EXAMPLES = re.findall(r"```python\n(.*?)```", TEXT, re.DOTALL)
TABLE = (
    "task",
    "Gymnasium id",
    "actions",
    "episode",
    "reward",
    "drawn at the start",
    "measured time",
)
REFERENCE = PAGE.parent / "reference" / "tasks"


def run(code, cwd):
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, cwd=cwd)
    assert done.returncode == 0, done.stderr
    return done.stdout


@pytest.mark.slow
@pytest.mark.parametrize("example", EXAMPLES[:4], ids=["load", "register", "make", "make_vec"])
def test_the_examples_run(example, tmp_path):
    if "gymnasium" in example:
        pytest.importorskip("gymnasium", reason="needs the extra `gym`")
    printed = run(example, tmp_path)
    if "print" in example:  # the policies in the examples earn something
        assert float(printed.split()[0]) > 150


@pytest.mark.slow
def test_the_example_of_stable_baselines_runs(tmp_path):
    pytest.importorskip("stable_baselines3", reason="needs the extra `baselines`")
    example = EXAMPLES[4]
    assert "learn(327_680)" in example
    changes = (("327_680", "1"), ("n_steps=256", "n_steps=8"), ("=2048", "=512"))
    # Episodes of a few steps: the mean return is printed once an episode is over.
    for long, short in (*changes, ("threads=2", "max_episode_steps=5")):
        assert long in example
        example = example.replace(long, short)
    assert "ep_rew_mean" in run(example, tmp_path)
    assert (tmp_path / "driver.zip").exists()


@pytest.mark.slow
def test_the_example_of_a_policy_runs(tmp_path):
    pytest.importorskip("stable_baselines3", reason="needs the extra `baselines`")
    (training,) = re.findall(r"^musebot (benchmark ppo .*)", TEXT, re.MULTILINE)
    assert "--steps 327680" in training
    command = training.replace("327680", "1").split()
    subprocess.run([sys.executable, "-m", "musebot", *command], cwd=tmp_path, check=True)
    example = EXAMPLES[5]
    assert "range(1000)" in example
    printed = run(example.replace("range(1000)", "range(20)"), tmp_path)
    assert re.fullmatch(r"0\.\d{3} \+- 0\.\d{3} a step\n", printed)


@pytest.mark.slow
def test_the_pictures_are_made_by_the_code_of_the_page(tmp_path, egl, monkeypatch):
    monkeypatch.delenv("MUJOCO_GL", raising=False)  # draws nothing in other tests
    run(EXAMPLES[6], tmp_path)
    made = {path.name for path in tmp_path.glob("*.png")}
    assert made == {path.name for path in (PAGE.parent / "images").glob("*_*.png")}
    for name in made:
        ours, kept = (Image.open(folder / name) for folder in (tmp_path, PAGE.parent / "images"))
        difference = np.asarray(ours, float) - np.asarray(kept, float)
        assert np.abs(difference).mean() < 3  # of 255; another renderer draws other edges


@pytest.mark.parametrize("name", TASKS)
def test_every_task_has_a_small_film_and_its_command(name):
    film = PAGE.parent / "images" / f"{name}.gif"
    with Image.open(film) as gif:
        assert gif.n_frames == 64
    assert film.stat().st_size < 300_000
    page = (REFERENCE / f"{name}.md").read_text()
    assert f"(../../images/{name}.gif)" in page
    (words,) = re.findall(r"^Reproduce: `musebot film (.*)`$", page, re.MULTILINE)
    made = parsed(Film, "musebot film", words.split())
    assert made.task == made.output.stem == name and made.out is None
    assert made.output.name == film.name


@pytest.mark.parametrize("name, definition", TASKS.items(), ids=TASKS)
def test_every_task_has_a_page_with_its_signals_and_a_picture(name, definition):
    page = (REFERENCE / f"{name}.md").read_text()
    for signal, (length, low, high) in definition.rules.shapes.items():
        cells = rf"\| `{signal}`[^|]*\| \({length},\) \| {low:g} \| {high:g} \|"
        assert re.search(cells, page), signal
    (picture,) = re.findall(r"\((\S+\.png)\)", page)
    assert (REFERENCE / picture).exists()


def test_the_table_matches_the_code():
    ids = {task: name for name, task in musebot.GYMNASIUM_TASKS.items()}
    assert f"| {' | '.join(TABLE)} |\n" in TEXT
    for name, definition in TASKS.items():
        steps = definition.time_limit / CONTROL_TIMESTEP
        length = "endless" if steps == float("inf") else f"{steps:,.0f} steps"
        limits = f"[-{definition.limit:g}, {definition.limit:g}]"
        start = f"| [{name}](reference/tasks/{name}.md) | `musebot/{ids[name]}` | {limits} |"
        line = next(line for line in TEXT.splitlines() if line.startswith(start))
        assert f"| {length} |" in line
        cells = [cell.strip() for cell in line.strip("| ").split("|")]
        assert len(cells) == len(TABLE) and all(cells)
