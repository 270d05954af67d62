"""Agents that drive robots: the paper's brain, other learners, fixed policies, users' agents."""
