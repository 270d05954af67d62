"""The situations of which figures show the values."""

import pytest

from musebot.protocols.pages.situations import grid, situations
from musebot.tasks import make_batch

WA, SF = "wall_avoidance", "spot_finding"


def test_situations_match_their_names():
    walls = situations(make_batch(WA, 1), WA)
    front, contact = {k: v[0] for k, v in walls.items()}, {k: v[4] for k, v in walls.items()}
    assert front["a wall 3 cm ahead"] == pytest.approx(1 / 1.03**10, rel=0.02)
    assert front["in the open"] < 0.05
    assert contact == {"in the open": 0, "a wall 3 cm ahead": 0, "pressed against it": -1}
    smells = {k: v[0] for k, v in situations(make_batch(SF, 1), SF).items()}
    assert smells["no smell"] == 0
    assert smells["spot 20 cm ahead"] == pytest.approx(3 / 4, rel=0.01)  # s' = 10 * 0.06 / 0.2
    assert smells["inside the spot"] == pytest.approx(10 / 11)


def test_the_grid_has_all_pairs_of_motor_values():
    values = sorted({value for pair in grid()[0].tolist() for value in pair})
    assert grid().shape == (1, len(values) ** 2, 2)
    assert (values[0], values[-1]) == (-0.5, 0.5)
    assert len({tuple(pair) for pair in grid()[0].tolist()}) == len(values) ** 2
