"""The numbers of tables 1 and 2."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType

from ..lives.conditions import Condition
from ..lives.learn_ability import Summary

_WALLS, _SPOT = "wall_avoidance", "spot_finding"

PAPER: Mapping[Condition, Summary] = MappingProxyType(
    {
        # Table 1, 500 robots in each column.
        Condition(_WALLS, "fixed"): Summary((260, 12, 13, 19, 196), 0.8232, 0.4959, 0.0584),
        Condition(_WALLS, "random"): Summary((196, 215, 1, 51, 37), 0.7150, 0.5137, 0.0160),
        Condition(_WALLS, "creative"): Summary((282, 65, 0, 80, 73), 0.6109, 0.7068, 0.0402),
        # Table 2, 500 robots in each column.
        Condition(_SPOT, "fixed"): Summary((22, 2, 1, 20, 455), 0.0800, 0.9681, 0.0440),
        Condition(_SPOT, "random"): Summary((20, 16, 0, 323, 141), -0.8064, 0.5631, 0.0296),
        Condition(_SPOT, "creative"): Summary((109, 63, 1, 170, 157), 0.0045, 0.8829, 0.2581),
    }
)
