"""The style of figures: a look for each agent, independent of Matplotlib's settings."""

import subprocess
import sys

from musebot.protocols.pages import style

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
draw("architecture", Path(sys.argv[1]))
print(matplotlib.rcParams["font.size"])
"""


def test_a_figure_has_the_same_bytes_whatever_a_matplotlibrc_says(tmp_path):
    (tmp_path / "with").mkdir()
    settings = "font.size: 20\ntext.usetex: True\naxes.facecolor: red\nsvg.fonttype: none\n"
    (tmp_path / "with" / "matplotlibrc").write_text(settings)
    drawn = []
    for folder, size in ((".", "10.0"), ("with", "20.0")):
        path = tmp_path / f"{folder}.svg"
        command = [sys.executable, "-c", DRAW, str(path)]
        done = subprocess.run(command, cwd=tmp_path / folder, capture_output=True, text=True)
        # What the user has set holds outside of our figures.
        assert done.stdout.strip() == size, done.stderr
        drawn.append(path.read_bytes())
    assert drawn[0] == drawn[1]
