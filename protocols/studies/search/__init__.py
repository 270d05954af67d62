"""Searches for parameters: evolution of a brain, and tuning of a learner."""
