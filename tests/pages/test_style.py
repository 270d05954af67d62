"""The style of figures: legible to all readers, and independent of Matplotlib's settings."""

import itertools
import math
import os
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from helpers import contrast
from matplotlib.colors import to_rgb

from musebot.protocols.pages import style

PROPOSERS = ("fixed", "random", "creative")


def test_ink_and_colours_contrast_with_light_and_dark_backgrounds():
    for shade in (style.INK, style.EVENT, *style.PALETTE):
        for background in ("#ffffff", "#14171c"):
            assert contrast(shade, background) >= 3  # bound of WCAG for graphics and large text


def test_small_text_contrasts_with_the_reports_page_by_day_and_by_night():
    template = Path(style.__file__).with_name("report.html.jinja").read_text()
    schemes = re.findall(r"--ink: (#\w+); --dim: (#\w+); --line: #\w+; --page: (#\w+);", template)
    assert len(schemes) == 2
    for *texts, page in schemes:
        for text in (style.INK, *texts):
            assert contrast(text, page) >= 4.5  # bound of WCAG for small text
    colours_of_text = re.findall(r"[{;] color: ?([^;}]+)", template)
    assert {"var(--ink)", "var(--dim)"} == set(colours_of_text)


# How a dichromat sees linear RGB: Viénot, Brettel and Mollon (1999).
DICHROMATS = {
    "protanopia": [[0.11238, 0.88762, 0], [0.11238, 0.88762, 0], [0.00401, -0.00401, 1]],
    "deuteranopia": [[0.29275, 0.70725, 0], [0.29275, 0.70725, 0], [-0.02234, 0.02234, 1]],
}


@pytest.mark.parametrize("kind", DICHROMATS)
def test_colours_drawn_together_look_different_to_colour_blind_readers(kind):
    def seen(shade):
        linear = [((c + 0.055) / 1.055) ** 2.4 for c in to_rgb(shade)]
        return 1.055 * np.clip(DICHROMATS[kind] @ np.array(linear), 0, 1) ** (1 / 2.4) - 0.055

    lines = itertools.combinations(style.PALETTE, 2)  # solid lines of one figure
    paths = ((style.EVENT, style.colour(proposer)) for proposer in PROPOSERS)
    for pair in (*lines, *paths):
        assert math.dist(*map(seen, pair)) > 0.2, pair


def test_each_agent_of_a_run_has_its_own_look_and_proposers_keep_their_colours():
    agents = ["q_learner", "stream_q", "amortised_q", "hand_coded", "sarsa_lambda", "avg", "dqn"]
    names = [*agents[:2], *PROPOSERS, *agents[2:], *(f"mine:{number}" for number in range(5))]
    looks = style.looks([*names, *names])
    assert [*looks] == names and len({*looks.values()}) == len(names)
    assert all(looks[name] == (style.colour(name), "-") for name in PROPOSERS)
    solid = [look for look in looks.values() if look.dashes == "-"]
    assert len({look.colour for look in solid}) == len(solid) == 7


DRAW = """
import sys
from pathlib import Path
from musebot.protocols.pages.report import draw
import matplotlib
draw("architecture", Path(sys.argv[1]))
print(matplotlib.rcParams["font.size"], matplotlib.rcParams["backend"])
"""


def test_a_figure_has_the_same_bytes_whatever_matplotlib_is_told(tmp_path):
    """A backend that Matplotlib does not know stops its import; TeX may not be installed."""
    (tmp_path / "with").mkdir()
    settings = "font.size: 20\ntext.usetex: True\naxes.facecolor: red\nsvg.fonttype: none\n"
    (tmp_path / "with" / "matplotlibrc").write_text(settings)
    printed = []
    for folder, backend in ((".", "foo"), ("with", "pdf")):
        path = tmp_path / f"{folder}.svg"
        done = subprocess.run(
            [sys.executable, "-c", DRAW, str(path)],
            cwd=tmp_path / folder,
            env=os.environ | {"MPLBACKEND": backend},
            capture_output=True,
            text=True,
        )
        assert done.returncode == 0, done.stderr
        printed.append((done.stdout.split(), path.read_bytes()))
    (plain, first), (told, second) = printed
    # What the user has set holds outside of our figures, if Matplotlib knows it.
    assert plain[0] == "10.0" and told == ["20.0", "pdf"]
    assert first == second
