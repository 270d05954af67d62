"""docs/command.md matches the code, and its examples run."""

import re
import subprocess
import sys
from pathlib import Path

import pytest

import musebot
from musebot.controller import BRAINS
from musebot.protocols.cli.listing import LISTS
from musebot.protocols.lives.config import read_config

TEXT = (Path(__file__).parents[1] / "docs" / "command.md").read_text()


def test_the_configuration_file_is_read(tmp_path):
    (example,) = re.findall(r"```yaml\n(.*?)```", TEXT, re.DOTALL)
    (tmp_path / "run.yaml").write_text(example)
    config = read_config(tmp_path / "run.yaml")
    brain = config.fields["brain"]
    assert brain.ideas == 9 and brain.memory_hidden == BRAINS["steady"].memory_hidden
    assert [*config.robots.values()] == [2, 2]


def test_the_lists_are_named():
    assert f"| `list` | lists {', '.join(LISTS)} |" in TEXT.splitlines()


@pytest.mark.slow
def test_the_example_in_python_runs_without_a_guard(tmp_path):
    (example,) = re.findall(r"```python\n(.*?)```", TEXT, re.DOTALL)
    (tmp_path / "first.py").write_text(example)
    done = subprocess.run(
        [sys.executable, "first.py"], cwd=tmp_path, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    first, second = done.stdout.splitlines()
    assert first.startswith("spot_finding/creative (") and second == "(2, 1)"
    run = musebot.run(tmp_path / "runs" / "first", quiet=True)
    assert run.experiment.brain.ideas == 9
