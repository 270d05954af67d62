"""What networks are given of a state: the signals as in the paper, or stretched ones."""

import numpy as np
import pytest
import torch

from musebot.controller import BRAINS, Parameters, Senses, Signal
from musebot.controller.reading import Reading
from musebot.protocols.agents.base import senses_of
from musebot.tasks.sensors import Nose
from musebot.tasks.suite import TASKS

STEADY = BRAINS["steady"]


def test_the_paper_reads_signals_motors_and_reward_as_they_are():
    reading = Reading(Parameters(), 3, None)
    state = torch.rand(4, 3)
    assert reading.inputs == 3
    assert reading.state(state) is state
    assert reading.motors(state) is state
    assert reading.reward(state) is state


def test_a_nose_is_read_as_2s_minus_1_and_as_the_raw_odour_from_minus_1_to_1():
    reading = Reading(STEADY, 1, senses_of("spot_finding"))
    s = torch.tensor([0.0, 0.5, 0.9, 10 / 11])[:, None]
    wanted = torch.cat([2 * s - 1, s / (5 * (1 - s)) - 1], dim=1)
    torch.testing.assert_close(reading.state(s), wanted)
    torch.testing.assert_close(reading.state(s)[-1], torch.tensor([9 / 11, 1.0]))
    torch.testing.assert_close(reading.reward(s[:, 0]), (s / (1 - s) / 10)[:, 0])


def test_noise_on_a_signal_makes_no_more_of_it_than_a_full_load_nor_less_than_none():
    reading = Reading(STEADY, 1, senses_of("spot_finding"))
    s = torch.tensor([-0.2, 0.95, 1.0, 1.1])
    torch.testing.assert_close(reading.reward(s), torch.tensor([0.0, 1.0, 1.0, 1.0]))
    torch.testing.assert_close(reading.state(s[:, None])[:, 1], torch.tensor([-1.0, 1.0, 1.0, 1.0]))


def test_the_raw_odour_is_that_of_equation_3():
    nose = Nose()
    ahead = np.array([0.03, 0.06, 0.12, 0.3, 0.6])
    signal = nose.signal(np.stack([ahead, np.zeros(5)], axis=-1))
    reading = Reading(STEADY, 1, senses_of("spot_finding"))
    raw = reading.reward(torch.from_numpy(signal)).numpy() * nose.odour
    np.testing.assert_allclose(raw, nose.odour * np.minimum(0.06 / ahead, 1), rtol=1e-9)


def test_walls_and_motors_are_read_from_minus_1_to_1_and_contact_is_the_reward():
    reading = Reading(STEADY, 5, senses_of("wall_avoidance"))
    assert reading.inputs == 5
    state = torch.tensor([[0.0, 0.25, 0.5, 1.0, -1.0], [0.0, 0.25, 0.5, 1.0, 0.0]])
    wanted = torch.tensor([[-1.0, -0.5, 0.0, 1.0, -1.0], [-1.0, -0.5, 0.0, 1.0, 1.0]])
    torch.testing.assert_close(reading.state(state), wanted)
    torch.testing.assert_close(reading.motors(torch.tensor([-0.5, 0.5])), torch.tensor([-1.0, 1.0]))
    assert torch.equal(reading.reward(state[:, 4]), state[:, 4])


def test_each_stretch_can_be_had_alone():
    senses, s = senses_of("spot_finding"), torch.tensor([[0.5]])
    centred = Reading(Parameters(centred=True), 1, senses)
    assert centred.state(s).tolist() == [[0.0]]
    assert centred.reward(s).tolist() == [[0.5]]
    raw = Reading(Parameters(raw_signals=True), 1, senses)
    torch.testing.assert_close(raw.state(s), torch.tensor([[0.5, 0.1]]))
    assert raw.motors(s) is s
    reward = Reading(Parameters(raw_reward=True), 1, senses)
    assert reward.state(s) is s
    torch.testing.assert_close(reward.reward(s), torch.tensor([[0.1]]))


@pytest.mark.parametrize("task", TASKS)
def test_every_tasks_signals_can_be_told_to_a_brain(task):
    senses = senses_of(task)
    rules = TASKS[task].rules
    assert len(senses.state) == sum(length for length, _, _ in rules.shapes.values())
    assert (senses.reward.low, senses.reward.high) == rules.rewards
    assert set(rules.maximal) <= {*rules.shapes, "reward"}


@pytest.mark.parametrize("told", [None, Senses((Signal(0.0, 1.0),) * 2, Signal(0.0, 1.0))])
def test_a_brain_that_stretches_signals_must_be_told_of_them(told):
    with pytest.raises(ValueError, match="must be told of all 3"):
        Reading(STEADY, 3, told)


@pytest.mark.parametrize("numbers", [(1.0, 1.0), (1.0, 0.0), (0.0, 1.0, 0.0), (0.0, 1.0, -1.0)])
def test_a_signal_between_nothing_and_nothing_is_refused(numbers):
    with pytest.raises(ValueError, match="must be .* got"):
        Signal(*numbers)
