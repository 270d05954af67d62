"""Checks of figure files that several tests need."""

from xml.etree import ElementTree

import numpy as np
import pytest
from PIL import Image


@pytest.fixture
def check_files():
    """Checks that a figure was written as .svg and .png, transparent and not empty."""

    def check(paths):
        assert [path.suffix for path in paths] == [".svg", ".png"]
        assert ElementTree.parse(paths[0]).getroot().tag.endswith("svg")
        picture = np.asarray(Image.open(paths[1]).convert("RGBA"))
        assert (picture[..., 3] == 0).mean() > 0.05  # the background is transparent
        assert (picture[..., 3] > 200).mean() > 0.005  # and something is drawn

    return check
