"""The panel of a film: every signal is visible, and everything is inside the frame."""

import dataclasses

import numpy as np
import pytest
from helpers import random_policy
from PIL import ImageDraw

from musebot.protocols.pages import scene
from musebot.protocols.pages.panel import HEIGHT, WIDTH, Panel
from musebot.protocols.pages.replay import Episode
from musebot.tasks.suite import TASKS

IMAGE = np.zeros((scene.HEIGHT, scene.WIDTH, 3), dtype=np.uint8)


@pytest.fixture
def drawn(monkeypatch):
    """The calls of Pillow's methods: their names, corners, shape (n, 2), and further arguments."""
    calls = []

    def spied(name, real):
        def spy(self, xy, *rest, **more):
            calls.append((name, np.reshape(xy, (-1, 2)), rest))
            return real(self, xy, *rest, **more)

        return spy

    for name in ("rectangle", "line", "text"):
        monkeypatch.setattr(
            ImageDraw.ImageDraw, name, spied(name, getattr(ImageDraw.ImageDraw, name))
        )
    return calls


@pytest.mark.parametrize("task", TASKS)
def test_the_panel_shows_every_signal_inside_the_frame_and_keeps_events(task, drawn):
    episode = Episode.of_policy(random_policy(task), "post", 0)
    shot, panel = next(episode.moments()), Panel(episode, speed=1, seconds=1)
    before = panel.frame(IMAGE, shot)
    assert before.shape == (HEIGHT, WIDTH, 3)
    for name, values in shot.signals.items():
        changes = [{"signals": {**shot.signals, name: np.where(one, 0.77, values)}}
                   for one in np.eye(len(values), dtype=bool)]  # fmt: skip
        for change in [{"contact": not shot.contact}] if name == "contact" else changes:
            assert (panel.frame(IMAGE, dataclasses.replace(shot, **change)) != before).any(), name
    for time, seconds in ((0.2, 0.1), (0.5, 0.1), (1.0, 0.3)):
        image = panel.frame(IMAGE, dataclasses.replace(shot, event_seconds=seconds, time=time))
    for name, corners, _ in drawn:  # Pillow clips what is outside
        assert (corners >= 0).all() and (corners <= (WIDTH, HEIGHT)).all(), (name, corners)
    # The event's colour from 0 to 0.2 s and from 0.5 s to the end.
    timeline = image[HEIGHT - 34, WIDTH - 220 : WIDTH - 21].astype(int)
    coloured = np.ptp(timeline, axis=1) > 60
    assert coloured[:38].all() and coloured[104:190].all() and not coloured[44:96].any()


def test_the_panel_writes_each_number_beside_its_name(drawn):
    distances = np.array([0.11, 0.22, 0.33, 0.44])
    episode = Episode.of_policy(random_policy("wall_avoidance"), "pre", 0)
    shot = next(episode.moments())
    shot = dataclasses.replace(
        shot, time=72.3, event_seconds=18.1, motors=np.array([0.25, -0.4]),
        signals={**shot.signals, "distances": distances},
    )  # fmt: skip
    Panel(episode, speed=1, seconds=100).frame(IMAGE, shot)
    rows = {}
    for name, ((_, y), *_), rest in drawn:
        if name == "text":
            rows.setdefault(round(y), []).append(rest[0])
    words = [word for row in rows.values() for word in row]
    assert {"before training", "01:12.3", "18.1 s", "25.0%"} <= {*words}
    for name, value in zip(("front", "back", "left", "right"), distances, strict=True):
        assert [name, f"{value:.3f}"] in rows.values()
    boxes = [corners for name, corners, _ in drawn if name == "rectangle"]
    for name, value, side in (("left", "+0.25", 1), ("right", "-0.40", -1)):
        (y,) = [y for y, found in rows.items() if found == [name, value]]
        groove, bar = [box for box in boxes if round(box[0, 1]) == y - 4]
        assert np.sign(bar[:, 0].sum() - groove[:, 0].sum()) == side  # of zero
