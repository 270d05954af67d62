"""The paper's two figures show our own objects: the networks of a brain, the parts of the model."""

import matplotlib.colors
import numpy as np
import pytest

from musebot.controller import Parameters
from musebot.protocols.pages import paper_figures, style
from musebot.protocols.pages.paper_figures import PARTS

NOISE = matplotlib.colors.to_hex("#cf7423")


@pytest.mark.parametrize(
    ("task", "memory", "evaluation", "noisy", "weights", "sensors"),
    [
        ("wall_avoidance", "5-5-2", "7-7-1", 9, 35, ["front", "back", "left", "right", "contact"]),
        ("spot_finding", "1-5-2", "3-7-1", 4, 15, ["nose"]),
    ],
)
def test_the_architecture_is_that_of_the_paper(task, memory, evaluation, noisy, weights, sensors):
    with style.styled():
        figure = paper_figures.architecture(task)
    axis, ideas = figure.axes
    words = [text.get_text() for text in axis.texts]
    assert f"creative memory: {memory}" in words
    assert f"evaluation network: {evaluation}" in words
    assert f"an idea: noise of 0.76 in {noisy} of {weights} weights" in words
    for name in sensors:
        assert words.count(name) >= 2  # an input of both networks
    lines = [
        line for line in axis.lines if len(line.get_xdata()) == 2 and line.get_marker() == "None"
    ]
    drawn = [line for line in lines if matplotlib.colors.to_hex(line.get_color()) == NOISE]
    assert len(drawn) == noisy
    inputs, hidden, values = map(int, evaluation.split("-"))
    assert len(lines) == weights + hidden * (inputs + values)
    assert len(ideas.lines[0].get_xdata()) == Parameters().ideas


def test_every_label_of_the_robot_points_into_the_robot(egl):
    with style.styled():
        figure = paper_figures.robot()
    (axis,) = figure.axes
    words = {text.get_text() for text in axis.texts}
    assert words == {part.words for part in PARTS}
    pixels = axis.images[0].get_array()
    for line in axis.lines:  # the floor is bright and without colour; the robot is dark or coloured
        (column, row), (height, width, _) = np.ravel(line.get_xydata()).astype(int), pixels.shape
        assert 0.2 < column / width < 0.8 and 0.1 < row / height < 0.9
        assert int(pixels[row, column].min()) < 180
