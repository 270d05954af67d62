"""Experiments of several runs or tests, each with a page of results: `musebot study NAME`."""
