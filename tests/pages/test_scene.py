"""The scene: everything in the arena and everything that the robot senses is visible."""

import dataclasses

import numpy as np
import pytest

from musebot.models import Dimensions, half_size
from musebot.models.arena_variants import OBSTACLES
from musebot.protocols.pages import scene
from musebot.protocols.pages.replay import Moment
from musebot.protocols.pages.scene import Trail
from musebot.tasks.suite import TASKS


@pytest.fixture(scope="module")
def drawn(egl: None) -> dict[str, np.ndarray]:
    """Images of every task: a robot below the middle that faces right, and one thing changed."""
    pose, trail = np.array([0.0, -0.2, 0.0]), Trail(np.zeros((1, 2)), np.zeros(1), np.zeros(1))
    images = {}
    for task, row in TASKS.items():
        canvas = scene.Scene(task)
        for name, spot, signal, contact in (
            ("plain", (-0.4, 0.2), 0.0, False),
            ("spot", (0.4, 0.2), 0.0, False),
            ("signal", (-0.4, 0.2), 0.9, False),
            ("contact", (-0.4, 0.2), 0.0, True),
        ):
            signals = {one: np.full(n, signal) for one, (n, *_) in row.rules.shapes.items()}
            shot = Moment(0.0, pose, np.array(spot), signals, np.zeros(2), contact, False, 0.0)
            images[f"{task}/{name}"] = canvas.draw(shot, trail).astype(int)
        canvas.close()
    return images


def differ(first: np.ndarray, second: np.ndarray, x: float, y: float) -> bool:
    """Whether two images of the scene differ around x, y in metres."""
    column, row = round(360 + 630 * x), round(248 - 630 * y)
    near = slice(row - 3, row + 4), slice(column - 3, column + 4)
    return bool((np.abs(first[near] - second[near]) > 20).any())


@pytest.mark.parametrize("task", TASKS)
def test_scene_shows_the_arena_and_what_the_robot_senses(drawn, task):
    plain, spot, signal, contact = (
        drawn[f"{task}/{name}"] for name in ("plain", "spot", "signal", "contact")
    )
    assert plain.shape == (scene.HEIGHT, scene.WIDTH, 3)
    shapes = TASKS[task].rules.shapes
    smells, sees = not {"nose", "noses"}.isdisjoint(shapes), "distances" in shapes
    assert smells == task.startswith("spot")
    for x in (-0.4, 0.4):
        assert differ(plain, spot, x, 0.2) == smells
    for x, y, _ in OBSTACLES[::2]:  # beyond the reach of a nose
        empty = drawn["wall_avoidance/plain"]
        assert differ(plain, empty, x, y) == (task == "wall_avoidance_obstacles")
    assert differ(plain, signal, 0.1, -0.2 + 0.02) == smells  # in the frustum of a nose ahead
    aside = [differ(plain, signal, 0.08, -0.2 + side) for side in (-0.12, 0.12)]
    assert aside == [task == "spot_finding_two_noses"] * 2
    assert differ(plain, signal, -0.3, -0.2) == sees  # the ray of the rangefinder at the back
    assert differ(plain, contact, 0.0, -0.2 + 0.034) == sees


def test_signal_is_grey_at_0_and_hot_at_1():
    hot = (1.0, 0.0, 0.0)
    assert scene.heat(1.0, hot) == hot
    assert scene.heat(0.0, hot) == scene.GREY
    assert scene.heat(0.5, hot) == scene.AMBER


def test_a_nose_at_the_centre_is_drawn_where_it_is(egl: None):
    own = Dimensions.of(TASKS["spot_finding"].spec().compile())
    for changes, expected in (
        ({}, [0.525, 0.35, 0.0275]),
        ({"nose": 0.0}, [0.525, 0.35, 0.0]),
    ):
        drawn = scene.Scene("spot_finding", dataclasses.replace(own, **changes))
        model = drawn._model
        drawn.close()
        assert [*half_size(model), model.site("nose").pos[0]] == pytest.approx(expected)


def test_the_sector_of_a_turned_nose_and_no_line_to_another_place_are_drawn(egl: None):
    canvas = scene.Scene("spot_finding")
    still = Trail(np.zeros((1, 2)), np.zeros(1), np.zeros(1))
    placed = Trail(np.array([[0.3, 0.2], [-0.3, 0.2]]), np.zeros(2), np.zeros(2))
    shot = Moment(
        0.0, np.array([0.0, -0.2, 0.0]), np.array([0.4, 0.3]), {"nose": np.array([0.9])},
        np.zeros(2), contact=False, event=False, event_seconds=0.0,
    )  # fmt: skip
    ahead = canvas.draw(shot, still).astype(int)
    left = canvas.draw(dataclasses.replace(shot, nose=np.pi / 2), still).astype(int)
    trail = canvas.draw(shot, placed).astype(int)
    canvas.close()
    assert differ(ahead, left, 0.15, -0.2) and differ(ahead, left, 0.0, -0.05)
    assert not differ(ahead, trail, 0.0, 0.2)


def test_a_ring_is_drawn_around_a_spot_while_the_robot_is_in_it(egl: None):
    canvas = scene.Scene("spot_finding")
    still = Trail(np.zeros((1, 2)), np.zeros(1), np.zeros(1))
    images = {}
    for away in (0.05, 0.4):
        for event in (False, True):  # true at any place if something else is rewarded
            shot = Moment(
                0.0, np.array([0.0, 0.0, 0.0]), np.array([away, 0.0]), {"nose": np.zeros(1)},
                np.zeros(2), contact=False, event=event, event_seconds=0.0,
            )  # fmt: skip
            images[away, event] = canvas.draw(shot, still).astype(int)
    canvas.close()
    assert differ(images[0.05, False], images[0.05, True], 0.05 + 0.062, 0.0)
    assert not differ(images[0.4, False], images[0.4, True], 0.4 + 0.062, 0.0)
