"""The kinematic simulator: robots in lockstep, as arrays of NumPy or as tensors of PyTorch."""
