"""The style of figures: a look for each agent, independent of Matplotlib's settings."""

import subprocess
import sys
import warnings

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
from musebot.protocols.pages import style
import matplotlib

def draw(name):
    with style.styled():
        figure, axes = style.canvas(2, 1, 1)
        axes[0, 0].set_title("title")
        style.save(figure, Path(name).parent, Path(name).name)

draw(sys.argv[1])
print(matplotlib.rcParams["font.size"])
"""


def test_a_figure_has_the_same_bytes_whatever_a_matplotlibrc_says(tmp_path):
    settings = "font.size: 20\ntext.usetex: True\naxes.facecolor: red\nsvg.fonttype: none\n"
    (tmp_path / "with").mkdir()
    (tmp_path / "with/matplotlibrc").write_text(settings)
    for folder, size in ((tmp_path, "10.0"), (tmp_path / "with", "20.0")):
        command = [sys.executable, "-c", DRAW, str(folder / "drawn")]
        done = subprocess.run(command, cwd=folder, capture_output=True, text=True)
        assert done.stdout.strip() == size, done.stderr  # outside of our figures it holds
    for name in ("drawn.svg", "drawn.png"):
        assert (tmp_path / name).read_bytes() == (tmp_path / "with" / name).read_bytes()


def test_a_title_is_drawn_as_it_is_written_also_without_a_glyph(tmp_path):
    with warnings.catch_warnings(), style.styled():
        warnings.simplefilter("error")
        figure, axes = style.canvas(1, 1, 1)
        axes[0, 0].set_title("5 $, 6 $^ and \u4e16")
        style.save(figure, tmp_path, "figure")
    assert {path.name for path in tmp_path.iterdir()} == {"figure.svg", "figure.png"}
