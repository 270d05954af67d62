"""Small seeded lives whose arrays must stay equal: a refactoring changes no result.

`python tests/test_golden.py` writes `golden.json` anew, after a change of results that CHANGELOG.md
announces; `python tests/test_golden.py add` adds the digests of another processor. Digests are
compared where processor and libraries compute as those of one of them did: `probe` computes with
the libraries alone, so no change of ours can make it differ.
"""

import hashlib
import json
import sys
from pathlib import Path

import mujoco
import numpy as np
import pytest
import torch

from musebot.controller import BRAINS
from musebot.protocols.runs.cohort import Cohort
from musebot.protocols.runs.conditions import CohortKey, Condition
from musebot.protocols.runs.config import named_reading
from musebot.protocols.runs.experiment import Experiment

GOLDEN = Path(__file__).with_name("golden.json")
SMALL = dict(seed=20041, cohort_size=4, time_scale=0.002)
TASKS = ("wall_avoidance", "spot_finding")
LIVES = {
    f"{body} {brain} {proposer} {task}": (
        dict(body=body, brain=BRAINS[brain]),
        Condition(task, proposer),
    )
    for body in ("mujoco", "kinematic")
    for brain in ("paper", "steady")
    for proposer in ("fixed", "random", "creative")
    for task in TASKS
}
LIVES |= {
    f"plain creative {task}": (named_reading("plain"), Condition(task, "creative"))
    for task in TASKS
}
LIVES |= {
    "kinematic walls sensed": (
        dict(body="kinematic", brain=BRAINS["steady"]),
        Condition("spot_finding_walls", "creative"),
    ),
    "kinematic recurrent": (
        dict(body="kinematic", brain=BRAINS["recurrent"]),
        Condition("spot_finding", "creative"),
    ),
    "kinematic sarsa_lambda": (
        dict(body="kinematic", signals="raw"),
        Condition("spot_finding", "musebot:sarsa_lambda"),
    ),
}

BALL = """<mujoco><worldbody><geom type="plane" size="1 1 1"/><body pos="0 0 .1"><freejoint/>
<geom size=".05 .02" type="cylinder"/></body></worldbody></mujoco>"""


def digest(arrays):
    """Returns the SHA-256 of arrays by name: their names, types, shapes and bytes."""
    found = hashlib.sha256()
    for name, array in sorted(arrays.items()):
        array = np.ascontiguousarray(array)
        found.update(f"{name} {array.dtype.str} {array.shape} ".encode())
        found.update(array.tobytes())
    return found.hexdigest()


def probe():
    """Returns a digest of what the libraries compute here, without any code of ours."""
    torch.manual_seed(0)
    x = torch.randn(7, 33)
    numbers = x.numpy().astype(float)
    model = mujoco.MjModel.from_xml_string(BALL)
    data = mujoco.MjData(model)
    data.qvel[:] = 0.3, 0.1, 0, 1, 2, 3
    mujoco.mj_step(model, data, 300)
    return digest(
        {
            "torch": torch.cat([f(x) for f in (torch.tanh, torch.sigmoid, torch.exp, torch.sin)]),
            "matmul": torch.bmm(x[None], x.T[None]),
            "numpy": np.stack([np.exp(numbers), np.sin(numbers), np.arctan2(numbers, 0.3)]),
            "mujoco": data.qpos,
        }
    )


def arrays(lives):
    return {
        "steps": lives.events,
        "minutes": lives.minutes,
        "valid": lives.valid,
        **{f"before.{name}": array for name, array in lives.before.items()},
        **{f"after.{name}": array for name, array in lives.after.items()},
    }


def cohort_of(name):
    fields, condition = LIVES[name]
    return Cohort(Experiment(**SMALL | fields), CohortKey(condition, 0))


def digest_of_life(name):
    cohort = cohort_of(name)
    cohort.advance(cohort.steps)
    return digest(arrays(cohort.lives()))


def known():
    golden = json.loads(GOLDEN.read_text())
    if (here := probe()) not in golden:
        pytest.skip("another processor or other libraries compute other numbers")
    return golden[here]


@pytest.mark.parametrize("name", LIVES)
def test_a_seeded_life_has_the_arrays_that_it_always_had(name):
    wanted = known()[name]  # or skips
    assert digest_of_life(name) == wanted


if __name__ == "__main__":
    golden = json.loads(GOLDEN.read_text()) if sys.argv[1:] == ["add"] else {}
    golden[probe()] = {name: digest_of_life(name) for name in LIVES}
    GOLDEN.write_text(json.dumps(golden, indent=1) + "\n")
