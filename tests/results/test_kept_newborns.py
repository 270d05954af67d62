"""Newborn brains of kept runs: what a seed draws does not change between versions."""

from pathlib import Path

import numpy as np
import pytest

from musebot.protocols.agents.factory import make_agent
from musebot.protocols.experiment.conditions import CohortKey
from musebot.protocols.experiment.manifest import read_manifest
from musebot.protocols.experiment.random_streams import random_streams
from musebot.protocols.results.run_files import read_run

RESULTS = Path(__file__).parents[2] / "docs" / "results"
RUNS = sorted(
    path.parent
    for path in RESULTS.rglob("brains.safetensors")
    if any(condition.has_brain for condition in read_manifest(path.parent).robots)
)


def test_there_are_kept_runs_with_brains():
    assert RUNS


@pytest.mark.parametrize("folder", RUNS, ids=lambda path: str(path.relative_to(RESULTS)))
def test_a_kept_runs_seed_still_draws_its_newborns(folder):
    run, found = read_run(folder), 0
    for condition in run.conditions():
        if not condition.has_brain:
            continue
        seed, _ = random_streams(run.experiment.seed, CohortKey(condition, 0))
        size = run.experiment.cohort_size
        born = make_agent(run.experiment, condition, size, seed).weights()
        kept = run.networks(condition, "before")
        for name, weights in born.items():
            if name in kept:
                np.testing.assert_array_equal(kept[name][:size], weights, err_msg=name)
                found += 1
    assert found >= 4 * len([c for c in run.conditions() if c.has_brain])
