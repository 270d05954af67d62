"""Signals, and their encoding: the paper's and the scaled one."""

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from musebot.controller import Signal
from musebot.controller.senses import Encoding, unsaturated

NOSE = Signal(0.0, 1.0, 10.0)


@pytest.mark.parametrize(
    "numbers", [(1.0, 1.0), (1.0, 0.0), (0.0, 1.0, 0.0), (0.0, 1.0, -1.0), (-1.0, 1.0, 10.0)]
)
def test_a_range_that_is_empty_or_cannot_saturate_is_refused(numbers):
    with pytest.raises(ValueError, match="must be .* got|is not negative, got low -1"):
        Signal(*numbers)


@given(st.floats(0.03, 0.6), st.floats(1, 1000))
def test_the_raw_odour_is_that_of_equation_3(distance, maximal):
    odour = maximal * min(0.06 / distance, 1)  # s'_n straight ahead, r = 0.06 m
    signal = torch.tensor(odour / (1 + odour), dtype=torch.float64)
    raw = unsaturated(signal, torch.tensor(maximal, dtype=torch.float64)) * maximal
    assert raw.item() == pytest.approx(odour, rel=1e-9)


def test_a_nose_is_encoded_as_2s_minus_1_and_as_the_raw_odour_from_minus_1_to_1():
    encoding = Encoding((NOSE,), centred=True, raw_signals=True)
    assert encoding.inputs == 2
    s = torch.tensor([0.0, 0.5, 0.9, 10 / 11])[:, None]
    expected = torch.cat([2 * s - 1, s / (5 * (1 - s)) - 1], dim=1)
    torch.testing.assert_close(encoding.state(s), expected)
    noisy = torch.tensor([-0.2, 0.95, 1.0, 1.1])[:, None]  # clipped to no and maximal smell
    assert encoding.state(noisy)[:, 1].tolist() == pytest.approx([-1.0, 1.0, 1.0, 1.0])
