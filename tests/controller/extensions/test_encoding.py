"""Encoding of inputs and reward beyond the paper."""

import torch

from musebot.controller import Senses, Signal
from musebot.controller.extensions.encoding import InputEncoding, RawReward

NOSE = Signal(0.0, 1.0, 10.0)
SPOT = Senses((NOSE,), NOSE)
WALLS = Senses((*[Signal(0.0, 1.0)] * 4, Signal(-1.0, 0.0)), Signal(-1.0, 0.0))


def raw_reward(signal):
    """The reward that reaches a target."""
    target = RawReward(lambda reward, before, now: reward, NOSE.maximal)
    return target(signal, None, None)


def test_a_nose_is_encoded_as_2s_minus_1_and_as_the_raw_odour_from_minus_1_to_1():
    encoding = InputEncoding(SPOT, centred=True, raw_signals=True)
    assert encoding.inputs == 2
    s = torch.tensor([0.0, 0.5, 0.9, 10 / 11])[:, None]
    expected = torch.cat([2 * s - 1, s / (5 * (1 - s)) - 1], dim=1)
    torch.testing.assert_close(encoding.state(s), expected)
    torch.testing.assert_close(encoding.state(s)[-1], torch.tensor([9 / 11, 1.0]))
    torch.testing.assert_close(raw_reward(s[:, 0]), (s / (1 - s) / 10)[:, 0])


def test_raw_signals_are_clipped_to_the_range_from_no_to_maximal_smell():
    encoding = InputEncoding(SPOT, centred=True, raw_signals=True)
    s = torch.tensor([-0.2, 0.95, 1.0, 1.1])
    torch.testing.assert_close(raw_reward(s), torch.tensor([0.0, 1.0, 1.0, 1.0]))
    expected = torch.tensor([-1.0, 1.0, 1.0, 1.0])
    torch.testing.assert_close(encoding.state(s[:, None])[:, 1], expected)


def test_the_raw_odour_is_that_of_equation_3():
    distances = torch.tensor([0.03, 0.06, 0.12, 0.3, 0.6], dtype=torch.float64)
    odours = 10.0 * (0.06 / distances).clamp(max=1)  # s'_n straight ahead, r = 0.06 m, o = 10
    raw = raw_reward(odours / (1 + odours)) * 10.0
    torch.testing.assert_close(raw, odours, rtol=1e-9, atol=0)


def test_wall_signals_and_motors_are_encoded_from_minus_1_to_1():
    encoding = InputEncoding(WALLS, centred=True, raw_signals=True)
    assert encoding.inputs == 5
    state = torch.tensor([[0.0, 0.25, 0.5, 1.0, -1.0], [0.0, 0.25, 0.5, 1.0, 0.0]])
    expected = torch.tensor([[-1.0, -0.5, 0.0, 1.0, -1.0], [-1.0, -0.5, 0.0, 1.0, 1.0]])
    torch.testing.assert_close(encoding.state(state), expected)
    motors = encoding.motors(torch.tensor([-0.5, 0.5]))
    torch.testing.assert_close(motors, torch.tensor([-1.0, 1.0]))


def test_each_encoding_can_be_used_alone():
    s = torch.tensor([[0.5]])
    centred = InputEncoding(SPOT, centred=True, raw_signals=False)
    assert centred.state(s).tolist() == [[0.0]]
    raw = InputEncoding(SPOT, centred=False, raw_signals=True)
    torch.testing.assert_close(raw.state(s), torch.tensor([[0.5, 0.1]]))
    assert raw.motors(s) is s
