"""Signals, and their encoding: the paper's and the scaled one."""

import pytest
import torch

from musebot.controller import Senses, Signal
from musebot.controller.senses import Encoding, ScaledEncoding, unsaturated


def test_the_paper_encodes_signals_and_motors_as_they_are():
    encoding = Encoding(3)
    state = torch.rand(4, 3)
    assert encoding.inputs == 3
    assert encoding.state(state) is state
    assert encoding.motors(state) is state


@pytest.mark.parametrize("numbers", [(1.0, 1.0), (1.0, 0.0), (0.0, 1.0, 0.0), (0.0, 1.0, -1.0)])
def test_an_empty_range_and_a_maximum_that_is_not_positive_are_refused(numbers):
    with pytest.raises(ValueError, match="must be .* got"):
        Signal(*numbers)


def test_a_signal_that_saturates_cannot_be_negative():
    with pytest.raises(ValueError, match="a signal that saturates is not negative, got low -1"):
        Signal(-1.0, 1.0, 10.0)  # the raw signal of a punishment would be 0


def test_a_signal_saturates_at_the_maximal_raw_signal():
    assert Signal(0.0, 1.0, 10.0).saturated == 10 / 11
    assert Signal(0.0, 1.0).saturated == float("inf")


# Beyond the paper

NOSE = Signal(0.0, 1.0, 10.0)
MAXIMAL = torch.tensor(10.0)
SPOT = Senses((NOSE,), NOSE)
WALLS = Senses((*[Signal(0.0, 1.0)] * 4, Signal(-1.0, 0.0)), Signal(-1.0, 0.0))


def test_a_nose_is_encoded_as_2s_minus_1_and_as_the_raw_odour_from_minus_1_to_1():
    encoding = ScaledEncoding(SPOT, centred=True, raw_signals=True)
    assert encoding.inputs == 2
    s = torch.tensor([0.0, 0.5, 0.9, 10 / 11])[:, None]
    expected = torch.cat([2 * s - 1, s / (5 * (1 - s)) - 1], dim=1)
    torch.testing.assert_close(encoding.state(s), expected)
    torch.testing.assert_close(encoding.state(s)[-1], torch.tensor([9 / 11, 1.0]))
    torch.testing.assert_close(unsaturated(s[:, 0], MAXIMAL), (s / (1 - s) / 10)[:, 0])


def test_raw_signals_are_clipped_to_the_range_from_no_to_maximal_smell():
    encoding = ScaledEncoding(SPOT, centred=True, raw_signals=True)
    s = torch.tensor([-0.2, 0.95, 1.0, 1.1])
    torch.testing.assert_close(unsaturated(s, MAXIMAL), torch.tensor([0.0, 1.0, 1.0, 1.0]))
    expected = torch.tensor([-1.0, 1.0, 1.0, 1.0])
    torch.testing.assert_close(encoding.state(s[:, None])[:, 1], expected)


def test_the_raw_odour_is_that_of_equation_3():
    distances = torch.tensor([0.03, 0.06, 0.12, 0.3, 0.6], dtype=torch.float64)
    odours = 10.0 * (0.06 / distances).clamp(max=1)  # s'_n straight ahead, r = 0.06 m, o = 10
    raw = unsaturated(odours / (1 + odours), MAXIMAL) * 10.0
    torch.testing.assert_close(raw, odours, rtol=1e-9, atol=0)


def test_wall_signals_and_motors_are_encoded_from_minus_1_to_1():
    encoding = ScaledEncoding(WALLS, centred=True, raw_signals=True)
    assert encoding.inputs == 5
    state = torch.tensor([[0.0, 0.25, 0.5, 1.0, -1.0], [0.0, 0.25, 0.5, 1.0, 0.0]])
    expected = torch.tensor([[-1.0, -0.5, 0.0, 1.0, -1.0], [-1.0, -0.5, 0.0, 1.0, 1.0]])
    torch.testing.assert_close(encoding.state(state), expected)
    motors = encoding.motors(torch.tensor([-0.5, 0.5]))
    torch.testing.assert_close(motors, torch.tensor([-1.0, 1.0]))
