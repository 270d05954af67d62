"""Puts stored brains back into robots: evaluates, measures, films and shows them in a window."""
