"""Executes plans: cohorts of robots, their checkpoints, and the processes that run them."""
