"""The style of figures: a look for each agent, independent of Matplotlib's settings."""

import subprocess
import sys

from musebot.protocols.pages import report, style

PROPOSERS = ("fixed", "random", "creative")


def test_each_agent_of_a_run_has_its_own_look_and_proposers_keep_their_colours():
    agents = ["q_learner", "stream_q", "amortised_q", "hand_coded", "sarsa_lambda", "avg", "dqn"]
    names = [*agents[:2], *PROPOSERS, *agents[2:], *(f"mine:{number}" for number in range(5))]
    looks = {name: (*look.values(),) for name, look in style.looks([*names, *names]).items()}
    assert [*looks] == names and len({*looks.values()}) == len(names)
    assert all(looks[name] == (style.colour(name), "-") for name in PROPOSERS)
    solid = [colour for colour, dashes in looks.values() if dashes == "-"]
    assert len({*solid}) == len(solid) == 7


DRAW = """
import sys
from pathlib import Path
from musebot.protocols.pages.report import draw
import matplotlib
draw("architecture", Path(sys.argv[1]), task="spot_finding")
print(matplotlib.rcParams["font.size"])
"""


def test_a_figure_has_the_same_bytes_whatever_a_matplotlibrc_says(tmp_path):
    settings = "font.size: 20\ntext.usetex: True\naxes.facecolor: red\nsvg.fonttype: none\n"
    (tmp_path / "matplotlibrc").write_text(settings)
    ours, theirs = tmp_path / "ours.svg", tmp_path / "theirs.svg"
    report.draw("architecture", ours, task="spot_finding")
    command = [sys.executable, "-c", DRAW, str(theirs)]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True)
    assert done.stdout.strip() == "20.0", done.stderr  # outside of our figures it holds
    assert theirs.read_bytes() == ours.read_bytes()
