"""The panel of a film: every signal is visible, and everything is inside the frame."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from musebot.protocols.playback import film, scene
from musebot.protocols.playback.episode import Episode
from musebot.protocols.playback.panel import HEIGHT, WIDTH, Panel
from musebot.tasks.suite import TASKS

IMAGE = np.zeros((scene.HEIGHT, scene.WIDTH, 3), dtype=np.uint8)


@pytest.fixture
def shown(request, newborn):
    """A panel of a task, a shot of a robot at rest, and the frame of it."""
    task = request.param
    episode = Episode.of_policy(newborn(task), 0, "post", 0)
    (shot,) = film.shots_at([0.0], episode.moments(), episode.batch.rules, speed=1)
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
def test_everything_on_the_panel_is_inside_the_frame(shown):
    panel, shot, before = shown
    panel.frame(IMAGE, dataclasses.replace(shot, event=True, time=1.0))
    last = panel.frame(IMAGE, dataclasses.replace(shot, time=1.0))
    timeline = (last != before).any(axis=2).any(axis=1).nonzero()[0].max()
    assert timeline < HEIGHT - 5
