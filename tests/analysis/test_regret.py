"""Regret of ideas, and the situations in which it is measured."""

import pytest
import torch

from musebot.protocols.analysis import regret
from musebot.protocols.lives.agent import make_agent
from musebot.protocols.lives.conditions import Condition
from musebot.protocols.lives.experiment import Experiment
from musebot.tasks import make_batch

WA, SF = "wall_avoidance", "spot_finding"


def test_situations_match_their_names():
    walls = regret.situations(make_batch(WA, 1), WA)
    front, contact = {k: v[0] for k, v in walls.items()}, {k: v[4] for k, v in walls.items()}
    assert front["a wall 3 cm ahead"] == pytest.approx(1 / 1.03**10, rel=0.02)
    assert front["in the open"] < 0.05
    assert contact == {"in the open": 0, "a wall 3 cm ahead": 0, "pressed against it": -1}
    smells = {k: v[0] for k, v in regret.situations(make_batch(SF, 1), SF).items()}
    assert smells["no smell"] == 0
    assert smells["spot 20 cm ahead"] == pytest.approx(3 / 4, rel=0.01)  # s' = 10 * 0.06 / 0.2
    assert smells["inside the spot"] == pytest.approx(10 / 11)


def test_regret_is_none_for_the_best_action_and_the_whole_range_for_the_worst():
    agent = make_agent(Experiment(cohort_size=4), Condition(SF, "creative"), 4, 1)
    brain = agent.controller  # type: ignore[attr-defined]
    sensed = torch.rand(4, 1, generator=torch.Generator().manual_seed(0))
    actions = regret.grid().expand(4, -1, -1)
    assert regret.regret(brain, sensed, actions[:, None]).tolist() == [[0.0]] * 4
    values = brain.values(sensed, actions)
    for which, share in ((values.argmax(dim=1), 0.0), (values.argmin(dim=1), 1.0)):
        one = actions[torch.arange(4), which][:, None, None]
        # A single action's value is rounded differently from one of many.
        assert regret.regret(brain, sensed, one)[:, 0] == pytest.approx([share] * 4, abs=1e-5)
    half = (values.amax(dim=1) + values.amin(dim=1)) / 2
    nearest = (values - half[:, None]).abs().argmin(dim=1)
    one = actions[torch.arange(4), nearest][:, None, None]
    assert regret.regret(brain, sensed, one)[:, 0] == pytest.approx([0.5] * 4, abs=0.05)
