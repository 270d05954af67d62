"""The window: what drives the robot in it, and why it cannot be opened."""

import dataclasses
import sys
import types
from unittest.mock import Mock

import numpy as np
import pytest
from helpers import random_policy

from musebot import tasks
from musebot.protocols.errors import InputError
from musebot.protocols.pages import viewer
from musebot.tasks.suite import TASKS


@pytest.mark.skipif(sys.platform != "linux", reason="elsewhere there is always a display")
def test_a_window_that_cannot_be_opened_is_one_sentence(monkeypatch):
    for name in ("DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(name, raising=False)
    with pytest.raises(InputError, match="no display.*musebot film"):
        viewer.explore("wall_avoidance")
    monkeypatch.setattr(viewer, "no_window", lambda: "")
    monkeypatch.setenv("MUJOCO_GL", "egl")
    with pytest.raises(InputError, match="MUJOCO_GL is 'egl'"):
        viewer.explore("wall_avoidance")


def test_robot_with_another_body_is_refused(run, stored):
    for name, value in (
        ("body", "kinematic"), ("nose_place", "centre"), ("motor_speed", 0.1)
    ):  # fmt: skip
        experiment = dataclasses.replace(run.experiment, **{name: value})
        with pytest.raises(InputError, match=f"the default {name}, got a run with {value}"):
            viewer.Driver.of_robot(stored(run=dataclasses.replace(run, experiment=experiment)))


def test_brain_drives_the_task_and_is_the_same_in_every_episode(stored):
    policy = viewer.Driver.of_robot(stored(task="spot_finding")).policy
    environment = tasks.load("arena", "spot_finding", {"robot": (0, 0, 0), "spot": (0.3, 0.1)})
    episodes = []
    for _ in range(2):
        timestep, actions = environment.reset(), []
        for _ in range(5):
            actions.append(policy(timestep))
            timestep = environment.step(actions[-1])
        episodes.append(actions)
    np.testing.assert_array_equal(*episodes)


def test_random_motors_hold_each_value_for_some_steps():
    policy = viewer.random_motors(seed=0, steps=3)
    actions = [tuple(policy(None)) for _ in range(7)]
    assert [len({*actions[:k]}) for k in range(1, 8)] == [1, 1, 1, 2, 2, 2, 3]
    assert np.abs(actions).max() <= 0.5


class Listeners(list):
    """Like those of dm_control: `+=` takes a single listener."""

    __iadd__ = lambda self, listener: self.append(listener) or self  # noqa: E731


class Window:
    """Replaces dm_control's window without a display: simulates two steps and records actions."""

    opened = []  # noqa: RUF012

    def __init__(self, title):
        self.title, self.actions, self.listeners = title, [], Listeners()
        self._window = Mock(keyboard=Mock(on_key=self.listeners))
        self.opened.append(self)

    def launch(self, loader, policy):
        environment = loader()
        timestep = environment.reset()
        for press in (None, viewer.UP):
            for listener in self.listeners if press else ():
                listener(press, 1, 0)
            self.actions.append(policy(timestep))
            environment.action_spec().validate(self.actions[-1].astype(float))
            timestep = environment.step(self.actions[-1])


@pytest.fixture
def window(monkeypatch):
    application = types.SimpleNamespace(Application=Window)
    package = types.SimpleNamespace(application=application)
    monkeypatch.setitem(sys.modules, "dm_control.viewer", package)
    monkeypatch.setattr(viewer, "check_display", lambda: None)
    monkeypatch.setattr(Window, "opened", [])
    return Window


@pytest.mark.parametrize("task", TASKS)
def test_every_task_receives_actions_in_its_own_units(window, task):
    viewer.explore(task)
    viewer.explore(task, viewer.Driver.of_policy(random_policy(task), "post"))
    viewer.explore(task, viewer.Driver("arrow keys", viewer.ArrowKeys()))
    policy = viewer.Driver.of_policy(random_policy("spot_finding_walls"), "post").policy
    viewer.explore(task, viewer.Driver("walls", policy, task="spot_finding_walls"))
    by_chance, by_policy, by_keys, other = window.opened
    assert other.title == "Musebot: spot_finding_walls, walls"  # of the task that was learned
    assert by_policy.title == f"Musebot: {task}, PPO, post-training"
    assert np.abs(by_chance.actions).max() > 0
    limit = TASKS[task].limit
    np.testing.assert_array_equal(by_keys.actions, [[0, 0], [limit, limit]])


def test_a_robot_of_a_life_of_ones_own_drives_in_the_task_of_this_life(window):
    driver = viewer.Driver("robot", viewer.random_motors(seed=0), task="spot_finding")
    viewer.explore("my_life", driver)
    assert window.opened[0].title == "Musebot: spot_finding, robot"


def test_held_arrow_keys_drive_and_released_ones_stop():
    keys = viewer.ArrowKeys()
    press, repeat, release = 1, 2, 0
    for key, activity, motors in (
        (viewer.UP, press, [0.5, 0.5]),
        (viewer.UP, repeat, [0.5, 0.5]),
        (viewer.LEFT, press, [0.25, 0.5]),
        (viewer.UP, release, [-0.25, 0.25]),
        (32, press, [-0.25, 0.25]),  # the space bar belongs to the viewer
        (viewer.LEFT, release, [0, 0]),
        (viewer.DOWN, press, [-0.5, -0.5]),
        (viewer.RIGHT, press, [-0.25, -0.5]),
    ):
        keys.on_key(key, activity, 0)
        np.testing.assert_array_equal(keys(None), motors)
