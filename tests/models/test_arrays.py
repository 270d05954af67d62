"""One formula for arrays of NumPy and tensors of PyTorch."""

import numpy as np
import torch
from hypothesis import given
from hypothesis import strategies as st

from musebot.models import arrays


def test_numpys_arrays_are_computed_by_numpy_itself_and_tensors_by_their_library():
    assert arrays.namespace(np.zeros(2)) is np
    xp = arrays.namespace(torch.zeros(2))
    assert isinstance(xp.atan2(torch.ones(1), torch.ones(1)), torch.Tensor)


FUNCTIONS = (
    lambda values: arrays.at_least(values, -1.5),
    lambda values: arrays.at_most(values, 100.0),
    lambda values: arrays.replaced(values, values > 2, 7.0),
    lambda values: arrays.as_numbers(values > 2, values.dtype),
)


@given(st.lists(st.floats(-50, 150), min_size=1, max_size=20))
def test_tensors_give_what_arrays_give(values):
    array = np.array(values)
    for function in FUNCTIONS:
        ours, theirs = function(torch.from_numpy(array)), function(array)
        assert str(ours.dtype).removeprefix("torch.") == str(theirs.dtype) == "float64"
        np.testing.assert_allclose(ours, theirs, atol=1e-12)
