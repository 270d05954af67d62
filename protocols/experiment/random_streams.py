"""The random streams of a cohort, derived from the experiment's seed."""

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
    condition = zlib.crc32(str(key.condition).encode())
    sequence = np.random.SeedSequence(seed, spawn_key=(condition, key.index))
    brains, world = sequence.spawn(2)
    return int(brains.generate_state(1, np.uint64)[0] >> 1), np.random.default_rng(world)
