"""One formula for arrays of NumPy and tensors of PyTorch."""

import numpy as np
import torch

from musebot.models.arrays import namespace


def test_numpys_arrays_are_computed_by_numpy_itself_and_tensors_by_their_library():
    assert namespace(np.zeros(2)) is np
    xp = namespace(torch.zeros(2))
    assert isinstance(xp.atan2(torch.ones(1), torch.ones(1)), torch.Tensor)
