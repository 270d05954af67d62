"""The panel of a film: every signal is visible, and everything is inside the frame."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from PIL import ImageDraw

from musebot.protocols.pages import scene
from musebot.protocols.pages.panel import HEIGHT, WIDTH, Panel
from musebot.protocols.pages.replay import Episode
from musebot.tasks.suite import TASKS

IMAGE = np.zeros((scene.HEIGHT, scene.WIDTH, 3), dtype=np.uint8)


@pytest.fixture
def shown(request, newborn):
    """A panel of a task, a shot of a robot at rest, and the frame of it."""
    task = request.param
    episode = Episode.of_policy(newborn(task), 0, "post", 0)
    shot = next(episode.moments())
    panel = Panel(task, "nobody", True, speed=1, seconds=1)
    return panel, shot, panel.frame(IMAGE, shot)


@pytest.mark.parametrize("shown", TASKS, indirect=True)
def test_panel_shows_every_signal(shown):
    panel, shot, before = shown
    assert before.shape == (HEIGHT, WIDTH, 3)
    for name, values in shot.signals.items():
        if name == "contact":
            changed = [dataclasses.replace(shot, contact=not shot.contact)]
        else:
            changed = [
                dataclasses.replace(
                    shot, signals={**shot.signals, name: np.where(one, 0.77, values)}
                )
                for one in np.eye(len(values), dtype=bool)
            ]
        for other in changed:
            assert (panel.frame(IMAGE, other) != before).any(), name


@pytest.mark.parametrize("shown", TASKS, indirect=True)
def test_an_event_that_goes_on_is_one_interval_of_the_timeline(shown):
    panel, shot, _ = shown
    for time, event in ((0.2, True), (0.3, True), (0.4, True), (0.5, False), (0.6, True)):
        panel.frame(IMAGE, dataclasses.replace(shot, time=time, event=event))
    first, second = panel._events[-2:]
    assert first[1] == 0.4 and second == (0.5, 0.6)


@pytest.mark.parametrize("shown", TASKS, indirect=True)
def test_everything_on_the_panel_is_inside_the_frame(shown, monkeypatch):
    drawn = []

    def spied(name, real):
        def spy(self, xy, *rest, **more):
            drawn.append((name, np.reshape(xy, (-1, 2))))
            return real(self, xy, *rest, **more)

        return spy

    for name in ("rectangle", "line", "ellipse", "text"):
        real = getattr(ImageDraw.ImageDraw, name)
        monkeypatch.setattr(ImageDraw.ImageDraw, name, spied(name, real))
    panel, shot, _ = shown
    panel.frame(IMAGE, dataclasses.replace(shot, event=True, time=1.0))
    for name, corners in drawn:  # Pillow clips what is outside
        assert (corners >= 0).all() and (corners <= (WIDTH, HEIGHT)).all(), (name, corners)
    sizes = [np.ptp(corners, axis=0).tolist() for name, corners in drawn if name == "rectangle"]
    assert [200, 12] in sizes, "there is no timeline"


def test_the_panel_writes_each_number_beside_its_name(monkeypatch, newborn):
    written, boxes = [], []
    text, rectangle = ImageDraw.ImageDraw.text, ImageDraw.ImageDraw.rectangle

    def spy_text(self, xy, words, *rest, **more):
        written.append((round(xy[1]), words))
        return text(self, xy, words, *rest, **more)

    def spy_rectangle(self, box, *rest, **more):
        boxes.append(tuple(round(x) for x in box))
        return rectangle(self, box, *rest, **more)

    episode = Episode.of_policy(newborn("wall_avoidance"), 0, "post", 0)
    shot = next(episode.moments())
    distances = np.array([0.11, 0.22, 0.33, 0.44])
    shot = dataclasses.replace(
        shot, time=72.3, event_seconds=18.1, motors=np.array([0.25, -0.4]),
        signals={**shot.signals, "distances": distances},
    )  # fmt: skip
    monkeypatch.setattr(ImageDraw.ImageDraw, "text", spy_text)
    monkeypatch.setattr(ImageDraw.ImageDraw, "rectangle", spy_rectangle)
    Panel("wall_avoidance", "nobody", False, speed=1, seconds=100).frame(IMAGE, shot)
    rows = {}
    for y, words in written:
        rows.setdefault(y, []).append(words)
    pairs = [words for words in rows.values() if len(words) == 2]
    for name, value in zip(("front", "back", "left", "right"), distances, strict=True):
        assert [name, f"{value:.3f}"] in pairs
    assert ["left", "+0.25"] in pairs and ["right", "-0.40"] in pairs
    words = [words for _, words in written]
    assert {"before training", "01:12.3", "18.1 s", "25.0%"} <= {*words}
    bars = {}  # right of zero for a positive motor value, left of it for a negative one
    for name, value in (("left", "+0.25"), ("right", "-0.40")):
        (y,) = [y for y, found in rows.items() if found == [name, value]]
        groove, bar = [box for box in boxes if box[1] == y - 4]
        bars[name] = np.sign(sum(bar[::2]) - sum(groove[::2]))
    assert bars == {"left": 1, "right": -1}
