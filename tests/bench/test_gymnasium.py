"""The comparison of the doors compares equal work."""

import pytest

pytest.importorskip("gymnasium", reason="needs the extra `gym`")

from musebot.protocols.bench.gymnasium import Doors, measure  # noqa: E402


def test_bare_physics_and_the_batch_do_the_same_work_and_both_are_timed():
    doors = measure(robots=4, threads=2, rounds=2, steps=5)  # raises where they differ
    assert doors.substeps == 14
    assert len(doors.batch) == len(doors.bare) == len(doors.single) == 2
    assert min(*doors.batch, *doors.bare, *doors.single) > 0


def test_rates_are_the_medians_of_the_rounds():
    doors = Doors(10, 2, 14, (1.0, 2.0, 4.0), (0.9, 1.0, 3.6), (4.0, 10.0, 16.0), ())
    assert doors.of_bare == 0.9
    assert doors.of_single == 4.0
    assert "at 0.90 of bare physics and at 4.0 times single ones" in doors.table()
    assert "| `make_vec`, the batch | 5 | 70 |" in doors.table()
