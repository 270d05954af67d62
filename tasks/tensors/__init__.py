"""Robots in lockstep as tensors of PyTorch, for populations on a GPU."""
