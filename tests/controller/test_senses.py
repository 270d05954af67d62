"""Signals, and the paper's encoding of them."""

import pytest
import torch

from musebot.controller import Signal
from musebot.controller.senses import DirectEncoding


def test_the_paper_encodes_signals_and_motors_as_they_are():
    encoding = DirectEncoding(3)
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
