"""Trained drivers that come with musebot: a creative robot, and a policy for each task."""

from __future__ import annotations

from pathlib import Path

_HERE = Path(__file__).parent

# The only robot of `musebot run robot --brain steady --robots 1 --task spot_finding --proposer
# creative`, so not chosen among several.
ROBOT = _HERE / "robot"


def policy_file(task: str) -> Path:
    """Returns the file of the policy that PPO trained on a task; it exists for the suite's tasks.

    Each is the policy of `musebot study ppo OUT --task TASK --policies 1 --steps 327680`.
    """
    return _HERE / f"{task}.safetensors"
