"""Stored brains at work: put back into robots, watched, filmed and shown in a window."""
