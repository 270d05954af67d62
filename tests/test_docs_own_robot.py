"""docs/own-robot.md matches the code, and its examples run."""

import re
import subprocess
import sys
from pathlib import Path

import pytest

from musebot.models import arena

TEXT = (Path(__file__).parents[1] / "docs" / "own-robot.md").read_text()
EXAMPLES = re.findall(r"```python\n(.*?)```", TEXT, re.DOTALL)


def run(code, cwd):
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, cwd=cwd, check=False
    )
    assert done.returncode == 0, done.stderr
    return [float(number) for number in re.findall(r"-?\d+\.?\d*(?:e[-+]?\d+)?", done.stdout)]


@pytest.mark.slow
def test_the_robot_attaches_to_a_spec(tmp_path):
    driven, touch, still = run(EXAMPLES[0], tmp_path)
    assert driven == pytest.approx(0.28 - 0.0275, abs=1e-3) and touch > 0
    assert abs(still) < 1e-6
    left_out = EXAMPLES[0].replace("# robot.delete", "robot.delete")
    assert left_out != EXAMPLES[0]
    fixed, *_ = run(left_out, tmp_path)
    assert fixed == 0


@pytest.mark.slow
def test_the_robot_attaches_in_pymjcf(tmp_path):
    place, qpos = run(EXAMPLES[1], tmp_path)
    assert 0.15 < place == qpos < 0.2  # a second at 0.2 m/s, from rest


@pytest.mark.slow
def test_the_robot_is_an_entity_of_composer(tmp_path):
    touch, ahead, *others = run(EXAMPLES[2], tmp_path)
    assert touch == 1 and 0 <= ahead < 1e-3 and others == [-1, -1, -1]


@pytest.mark.slow
def test_a_task_opens_in_an_arena_from_a_file(tmp_path):
    x, y, heading = run(EXAMPLES[3], tmp_path)
    assert x == pytest.approx(-0.35 - 0.0275, abs=1e-3)
    assert y == pytest.approx(-0.2, abs=2e-3) and abs(heading) < 0.05


@pytest.mark.slow
def test_a_task_opens_with_another_robot(tmp_path):
    pytest.importorskip("gymnasium", reason="needs the extra `gym`")
    assert run(EXAMPLES[4], tmp_path) == [8, 2]
    assert len(EXAMPLES) == 5


def test_the_table_has_everything_that_is_checked():
    rows = [line.split("|")[1:3] for line in TEXT.splitlines() if line.startswith("|")]
    for kind, names in arena._NEEDED.items():
        what = {"body": "bod"}.get(word := kind.name.removeprefix("mjOBJ_").lower(), word)
        listed = " ".join(row_names for needed, row_names in rows if what in needed)
        assert [name for name in names if f"`{name}`" not in listed] == [], word
