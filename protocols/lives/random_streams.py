"""Random streams of brains and placements, derived from the experiment's seed."""

from __future__ import annotations

import zlib

import numpy as np

from .conditions import CohortKey


def random_streams(seed: int, key: CohortKey) -> tuple[int, np.random.Generator]:
    """Derives a cohort's random streams.

    They depend only on the seed, the condition's name and the cohort's number: robots that are
    added later, and the number of processes, change nothing.

    Args:
      seed: Seed of the experiment.
      key: Condition and number of the cohort.

    Returns:
      The seed of the cohort's brains, and the generator that draws its placements.
    """
    return named_streams(seed, str(key.condition), key.index)


def named_streams(seed: int, name: str, *numbers: int) -> tuple[int, np.random.Generator]:
    """Derives the random streams of robots that a name and some numbers identify.

    Args:
      seed: Seed of the experiment.
      name: Name of what the robots do.
      *numbers: Numbers that tell them from others with this name.

    Returns:
      The seed of the robots' brains, and the generator that draws their placements.
    """
    key = (zlib.crc32(name.encode()), *numbers)
    brains, world = np.random.SeedSequence(seed, spawn_key=key).spawn(2)
    return int(brains.generate_state(1, np.uint64)[0] >> 1), np.random.default_rng(world)
