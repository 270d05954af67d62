"""The claims of section 4 of the paper, and the inequalities that they consist of.

The paper uses words without a number ("mostly", "far", "about", "many"). Each claim here states a
number for them. All numbers were chosen before any verdict was seen. The same tests judge the
paper's own tables where these print enough data.
"""

from __future__ import annotations

import dataclasses

from ...controller import PROPOSERS
from ..lives.conditions import Condition
from ..lives.learn_ability import CATEGORIES
from ..lives.run import Run
from .behaviour import Behaviour
from .claim_tests import (
    alike,
    arrive_late,
    born_spinners_touch_nothing,
    both,
    contour_then_spin,
    far_below,
    fewer,
    later,
    leads,
    mostly,
    ranks,
    settle,
    settlers_learn,
    spin,
    spin_more,
    spinners_near_the_centre,
    spoiled_without_contact,
    spun,
    stuck,
)
from .claims import Claim, ClaimResult, Evidence, ability, judge, post_share
from .paper_numbers import PAPER

_WALLS, _SPOT = "wall_avoidance", "spot_finding"
_ONES, _POSITIVE, _, _NEGATIVE, _UNMEASURED = CATEGORIES


def judge_all(run: Run, behaviour: Behaviour | None = None) -> list[ClaimResult]:
    """Judges every claim, in the paper's order.

    Args:
      run: The run.
      behaviour: Behaviour of the run's robots; None if they were not observed.

    Returns:
      A result for every claim; empty for a run with another protocol, another brain, or none of
      the paper's conditions, because it neither supports nor contradicts the claims.
    """
    experiment = run.experiment
    comparable = experiment.protocol == "paper" and experiment.brain_name == "paper"
    if not comparable or not any(condition in PAPER for condition in run.conditions()):
        return []
    own, paper = Evidence(run, behaviour), Evidence(None)
    return [
        dataclasses.replace(judge(claim, own), paper=judge(claim, paper).verdict)
        for claim in CLAIMS
    ]


# ---- The claims ----

_FIXED_W, _RANDOM_W, _CREATIVE_W = (Condition(_WALLS, p) for p in PROPOSERS)
_FIXED_S, _RANDOM_S, _CREATIVE_S = (Condition(_SPOT, p) for p in PROPOSERS)
_SPINS = (
    "After training most robots of each kind spin, for more than half of the test's first minutes."
)

CLAIMS = (
    Claim(_WALLS, "Fixed has the most geniuses.", ranks(_FIXED_W, _UNMEASURED, most=True)),
    Claim(_WALLS, "Random has the fewest geniuses.", ranks(_RANDOM_W, _UNMEASURED, most=False)),
    Claim(_WALLS, "Creative has most robots with L = 1.", ranks(_CREATIVE_W, _ONES, most=True)),
    Claim(_WALLS, "Creative has most robots with L < 0.", ranks(_CREATIVE_W, _NEGATIVE, most=True)),
    Claim(
        _WALLS,
        "Random's contact after training is the lowest.",
        leads(post_share, _RANDOM_W, "share of the time", highest=False),
    ),
    Claim(
        _WALLS,
        "Fixed has the best mean L.",
        leads(ability, _FIXED_W, "mean L", highest=True),
    ),
    Claim(
        _WALLS,
        "Random has the most robots with 0 < L < 1.",
        ranks(_RANDOM_W, _POSITIVE, most=True),
    ),
    Claim(
        _WALLS,
        "Many creative robots with L < 0, more than half, had no contact before training.",
        spoiled_without_contact(_CREATIVE_W),
    ),
    Claim(
        _WALLS,
        "Creative has more geniuses than random, and more robots with L = 1.",
        both(
            fewer(_RANDOM_W, _CREATIVE_W, _UNMEASURED),
            fewer(_RANDOM_W, _CREATIVE_W, _ONES),
        ),
    ),
    Claim(
        _WALLS,
        "After training fixed has the most robots that do not leave the wall: in contact for 95 % "
        "of the test or more.",
        stuck(_FIXED_W, 0.95),
    ),
    Claim(_WALLS, _SPINS, spin(_WALLS)),
    Claim(
        _WALLS,
        "Spinning often comes with a slow movement towards the arena's centre: most trained "
        "spinners come nearer to it.",
        spinners_near_the_centre(_WALLS),
    ),
    Claim(
        _WALLS,
        "A fixed robot that spins from birth is never punished: most of them have no contact.",
        born_spinners_touch_nothing(_FIXED_W),
    ),
    Claim(
        _SPOT,
        "All mean L are far below those of wall avoidance, by more than 0.5.",
        far_below(0.5),
    ),
    Claim(
        _SPOT,
        "Creative's mean L is about Fixed's, within 0.2.",
        alike(_CREATIVE_S, _FIXED_S, 0.2),
    ),
    Claim(
        _SPOT,
        "Fewer creative than random robots have L < 0.",
        fewer(_CREATIVE_S, _RANDOM_S, _NEGATIVE),
    ),
    Claim(_SPOT, "Fixed robots are mostly ignorant.", mostly(_FIXED_S, _UNMEASURED)),
    Claim(_SPOT, "Random robots mostly have L < 0.", mostly(_RANDOM_S, _NEGATIVE)),
    Claim(
        _SPOT,
        "Creative has by far the most robots with L = 1, more than twice any other.",
        ranks(_CREATIVE_S, _ONES, most=True, times=2),
    ),
    Claim(
        _SPOT,
        "Creative has the highest time in the spot after training.",
        leads(post_share, _CREATIVE_S, "share of the time", highest=True),
    ),
    Claim(
        _SPOT,
        "Before training quite a few creative robots, more than 5 %, stay in the spot, for half of "
        "the test or more.",
        settle(_CREATIVE_S, 0.05),
    ),
    Claim(
        _SPOT,
        "Most of these are easily trained: in the spot for half of training's last quarter.",
        settlers_learn(_CREATIVE_S),
    ),
    Claim(
        _SPOT,
        "Creative robots with L < 0 that arrive in both tests arrive later after training.",
        later(_CREATIVE_S),
    ),
    Claim(_SPOT, _SPINS, spin(_SPOT)),
    Claim(
        _SPOT,
        "After training fixed robots spin the most: their mean share of the time is the highest.",
        leads(spun, _FIXED_S, "time spinning", highest=True),
    ),
    Claim(
        _SPOT,
        "Spinning is reinforced: fixed robots spin more after training than before.",
        spin_more(_FIXED_S),
    ),
    Claim(
        _SPOT,
        "Robots of all kinds together first follow the spot's contour and later spin inside it, "
        "comparing the first and the last third of their time there in 20 minutes of learning.",
        contour_then_spin,
    ),
    Claim(
        _SPOT,
        "In the test many creative robots take 20 to 30 minutes to arrive: more than a quarter of "
        "those that arrive need 20 or more.",
        arrive_late(_CREATIVE_S, 0.25),
    ),
)
