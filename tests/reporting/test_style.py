"""The style of figures: legible on light and on dark, and for colour-blind readers."""

import math

import numpy as np
import pytest
from matplotlib.colors import to_rgb

from musebot.protocols.reporting import style


def luminance(shade):
    linear = [c / 12.92 if c <= 0.04045 else ((c + 0.055) / 1.055) ** 2.4 for c in to_rgb(shade)]
    return sum(w * c for w, c in zip((0.2126, 0.7152, 0.0722), linear, strict=True))


@pytest.mark.parametrize("background", ["#ffffff", "#14171c"])
@pytest.mark.parametrize("shade", [style.INK, *map(style.colour, ("fixed", "random", "creative"))])
def test_ink_and_colours_contrast_with_light_and_dark_backgrounds(shade, background):
    first, second = sorted([luminance(shade), luminance(background)])
    assert (second + 0.05) / (first + 0.05) >= 3  # bound of WCAG for graphics and large text


def seen_without_red_or_green(shade, kind):
    """Returns how a dichromat sees a colour: Viénot, Brettel and Mollon (1999), in linear RGB."""
    matrices = {
        "protanopia": [[0.11238, 0.88762, 0], [0.11238, 0.88762, 0], [0.00401, -0.00401, 1]],
        "deuteranopia": [[0.29275, 0.70725, 0], [0.29275, 0.70725, 0], [-0.02234, 0.02234, 1]],
    }
    linear = np.array([((c + 0.055) / 1.055) ** 2.4 for c in to_rgb(shade)])
    mixed = np.clip(np.array(matrices[kind]) @ linear, 0, 1)
    return 1.055 * mixed ** (1 / 2.4) - 0.055


@pytest.mark.parametrize("kind", ["protanopia", "deuteranopia"])
def test_proposers_look_different_to_colour_blind_readers(kind):
    seen = [
        seen_without_red_or_green(style.colour(p), kind) for p in ("fixed", "random", "creative")
    ]
    for first, second in ((0, 1), (0, 2), (1, 2)):
        assert math.dist(seen[first], seen[second]) > 0.2


def test_an_agent_has_its_own_colour():
    known = {style.colour(p) for p in ("fixed", "random", "creative")}
    assert style.colour("ppo") not in known
    assert len({style.colour(name) for name in ("ppo", "avg", "dqn", "newborn")}) > 1
